// Values of a plugin instance's attributes: numbers, words, and bulk arrays as text inside the compiled model.
//
// An array is "<type>:<count>:<base64>", type f64, f32, i32, i16 or i8, little endian, count in elements. Nothing else
// survives MJCF, mjSpec attachment and mjb files unchanged (decimal text loses digits).

#ifndef MJFRAMES_PLUGIN_ATTRIBUTES_H_
#define MJFRAMES_PLUGIN_ATTRIBUTES_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <system_error>
#include <type_traits>
#include <vector>

namespace mjframes {

// Decodes an array. On failure returns false and says in `error` what is wrong with the value.
bool DecodeArray(const char* value, std::vector<double>* out, std::string* error);
bool DecodeArray(const char* value, std::vector<int32_t>* out, std::string* error);

// Reads them; the first failure is kept as a sentence.
class Reader {
 public:
  Reader(const mjModel* m, int instance) : model_(m), instance_(instance) {}

  // The value of a key, "" where there is none.
  const char* Text(const char* key) const {
    const char* value = mj_getPluginConfig(model_, instance_, key);
    return value ? value : "";
  }

  bool Has(const char* key) const { return *Text(key) != '\0'; }

  double Number(const char* key) {
    const std::string_view text = Text(key);
    double value = 0;  // strtod would read it by the program's locale, which may want a comma
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || !std::isfinite(value) || value < 0) {
      Fail(std::string(key) + " is '" + std::string(text) + "' but has to be a number ≥ 0");
      return 0;
    }
    return value;
  }

  // A whole number from 1 to `most`.
  int Count(const char* key, int most) {
    const double value = Number(key);
    if (value >= 1 && value <= most && value == std::floor(value)) return static_cast<int>(value);
    Fail(std::string(key) + " is '" + Text(key) + "' but has to be a whole number from 1 to " + std::to_string(most));
    return 1;
  }

  template <typename T>
  std::vector<T> Array(const char* key) {
    std::vector<T> out;
    std::string error;
    if (!DecodeArray(Text(key), &out, &error)) Fail(std::string(key) + " " + error);
    if constexpr (std::is_floating_point_v<T>) {
      const bool finite = std::all_of(out.begin(), out.end(), [](T value) { return std::isfinite(value); });
      if (!finite) Fail(std::string(key) + " has values that are not finite");
    }
    return out;
  }

  // An array that may be left out: then `count` times `value`. Another count than that is a failure.
  template <typename T>
  std::vector<T> ArrayOr(const char* key, T value, size_t count) {
    if (!Has(key)) return std::vector<T>(count, value);
    std::vector<T> out = Array<T>(key);
    if (out.size() != count) Fail(std::string(key) + " has another number of values than what it belongs to");
    out.resize(count, value);
    return out;
  }

  void Fail(const std::string& what) {
    if (error_.empty()) error_ = what;
  }

  bool Check(bool good, const char* what) {
    if (!good) Fail(what);
    return error_.empty();
  }

  bool ok() const { return error_.empty(); }
  const std::string& error() const { return error_; }

 private:
  const mjModel* model_;
  int instance_;
  std::string error_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ATTRIBUTES_H_
