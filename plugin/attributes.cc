#include "attributes.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstddef>
#include <cstring>
#include <string_view>

namespace mjframes {
namespace {

static_assert(std::endian::native == std::endian::little, "arrays are stored little endian");

constexpr int8_t kNoDigit = -1;

constexpr std::array<int8_t, 256> MakeDigits() {
  std::array<int8_t, 256> digits{};
  digits.fill(kNoDigit);
  constexpr std::string_view alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  for (size_t i = 0; i < alphabet.size(); i++) {
    digits[static_cast<unsigned char>(alphabet[i])] = static_cast<int8_t>(i);
  }
  return digits;
}

constexpr std::array<int8_t, 256> kDigits = MakeDigits();

// Decodes exactly `size` bytes of padded base64; false if the text has more, fewer or other characters.
bool DecodeBase64(std::string_view text, std::byte* out, size_t size) {
  if (text.size() != (size + 2) / 3 * 4) return false;
  size_t written = 0;
  for (size_t i = 0; i < text.size(); i += 4) {
    uint32_t bits = 0;
    for (size_t c = 0; c < 4; c++) {
      const char letter = text[i + c];
      const bool padding = letter == '=' && i + 4 == text.size() && c >= 2;
      const int8_t digit = padding ? 0 : kDigits[static_cast<unsigned char>(letter)];
      if (digit == kNoDigit) return false;
      bits = bits << 6 | static_cast<uint32_t>(digit);
    }
    for (int shift = 16; shift >= 0 && written < size; shift -= 8) {
      out[written++] = static_cast<std::byte>(bits >> shift & 0xff);
    }
  }
  return written == size;
}

// Decodes `count` elements that are stored as S.
template <typename S, typename T>
bool DecodeElements(std::string_view data, size_t count, std::vector<T>* out) {
  // a count that the text has no room for is refused before anything is allocated for it
  if (count > data.size()) return false;
  std::vector<S> stored(count);
  if (!DecodeBase64(data, reinterpret_cast<std::byte*>(stored.data()), count * sizeof(S))) return false;
  out->assign(stored.begin(), stored.end());
  return true;
}

// A type that elements may be stored as.
template <typename T>
struct Stored {
  std::string_view name;
  bool (*decode)(std::string_view data, size_t count, std::vector<T>* out);
};

template <typename T, size_t n>
bool Decode(const Stored<T> (&types)[n], const char* value, std::vector<T>* out, std::string* error) {
  const std::string_view text = value ? value : "";
  const size_t first = text.find(':');
  const size_t second = first == text.npos ? text.npos : text.find(':', first + 1);
  const auto type =
      std::find_if(types, types + n, [&](const Stored<T>& some) { return some.name == text.substr(0, first); });
  if (second == text.npos || type == types + n) {
    *error = "is not an array of type";
    for (size_t i = 0; i < n; i++) *error += (i == 0 ? " " : " or ") + std::string(types[i].name);
    return false;
  }
  size_t count = 0;
  const char* begin = text.data() + first + 1;
  const char* end = text.data() + second;
  const auto parsed = std::from_chars(begin, end, count);
  if (parsed.ec != std::errc() || parsed.ptr != end) {
    *error = "has no valid element count";
    return false;
  }
  if (!type->decode(text.substr(second + 1), count, out)) {
    *error = "is truncated or damaged";
    return false;
  }
  return true;
}

constexpr Stored<double> kReals[] = {{"f64", DecodeElements<double, double>}, {"f32", DecodeElements<float, double>}};
constexpr Stored<int32_t> kIntegers[] = {{"i32", DecodeElements<int32_t, int32_t>},
                                         {"i16", DecodeElements<int16_t, int32_t>},
                                         {"i8", DecodeElements<int8_t, int32_t>}};

}  // namespace

bool DecodeArray(const char* value, std::vector<double>* out, std::string* error) {
  return Decode(kReals, value, out, error);
}

bool DecodeArray(const char* value, std::vector<int32_t>* out, std::string* error) {
  return Decode(kIntegers, value, out, error);
}

}  // namespace mjframes
