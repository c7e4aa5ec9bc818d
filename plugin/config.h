// Configuration values of the plugin: bulk arrays as text inside the compiled model.
//
// An array is "<type>:<count>:<base64>", type f64 or i32, little endian, count in elements. Nothing else
// survives MJCF, mjSpec attachment and mjb files unchanged (decimal text loses digits).

#ifndef MJFRAMES_PLUGIN_CONFIG_H_
#define MJFRAMES_PLUGIN_CONFIG_H_

#include <cstdint>
#include <string>
#include <vector>

namespace mjframes {

// Decodes an array. On failure returns false and says in `error` what is wrong with the value.
bool DecodeArray(const char* value, std::vector<double>* out, std::string* error);
bool DecodeArray(const char* value, std::vector<int32_t>* out, std::string* error);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CONFIG_H_
