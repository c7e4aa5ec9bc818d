// Values that never change, made once and kept for whoever asks with the same key while anyone does: mjDatas of a
// model, of its copies, and of models with the same soft body in them. Any threads may ask; none waits while a value is
// made.

#ifndef MJFRAMES_PLUGIN_INTERNED_H_
#define MJFRAMES_PLUGIN_INTERNED_H_

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace mjframes {

// The value of a key; make() gives a unique_ptr to a new one, null for none.
template <typename T, typename Make>
std::shared_ptr<const T> Interned(const std::string& key, const Make& make) {
  struct Known {
    std::mutex mutex;
    std::map<std::string, std::weak_ptr<const T>> values;
  };
  static Known& known = *new Known;  // never destroyed: mjDatas may outlive static objects
  {
    const std::lock_guard lock(known.mutex);
    const auto found = known.values.find(key);
    if (found != known.values.end()) {
      if (std::shared_ptr<const T> value = found->second.lock()) return value;
    }
  }
  std::unique_ptr<const T> made = make();
  if (!made) return nullptr;
  std::shared_ptr<const T> mine(made.release(), [](const T* value) {
    delete value;
    const std::lock_guard lock(known.mutex);
    std::erase_if(known.values, [](const auto& entry) { return entry.second.expired(); });
  });
  std::shared_ptr<const T> other;  // what another thread has made meanwhile; let go of after the lock is
  const std::lock_guard lock(known.mutex);
  std::weak_ptr<const T>& value = known.values[key];
  other = value.lock();
  if (!other) value = mine;
  return other ? other : mine;
}

// Collects what a value is made of: the bytes of arrays, with their lengths.
class Key {
 public:
  template <typename T>
  Key& Add(const T* values, size_t count) {
    text_.append(reinterpret_cast<const char*>(&count), sizeof(count));
    if (count > 0) text_.append(reinterpret_cast<const char*>(values), count * sizeof(T));
    return *this;
  }

  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_INTERNED_H_
