#include "attributes.h"

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

template <typename T>
bool Decode(std::string_view type, const char* value, std::vector<T>* out, std::string* error) {
  const std::string_view text = value ? value : "";
  const size_t first = text.find(':');
  const size_t second = first == text.npos ? text.npos : text.find(':', first + 1);
  if (second == text.npos || text.substr(0, first) != type) {
    *error = "is not an array of type " + std::string(type);
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
  // a count that the text has no room for is refused before anything is allocated for it
  const std::string_view data = text.substr(second + 1);
  const bool fits = count <= data.size();
  if (fits) out->resize(count);
  if (!fits || !DecodeBase64(data, reinterpret_cast<std::byte*>(out->data()), count * sizeof(T))) {
    *error = "is truncated or damaged";
    return false;
  }
  return true;
}

}  // namespace

bool DecodeArray(const char* value, std::vector<double>* out, std::string* error) {
  return Decode("f64", value, out, error);
}

bool DecodeArray(const char* value, std::vector<int32_t>* out, std::string* error) {
  return Decode("i32", value, out, error);
}

}  // namespace mjframes
