#include "scaling.h"

#include <cmath>
#include <string>

namespace mjframes {
namespace {

// The numeric that is called as the instance is but for `key` in it, −1 for none. MuJoCo puts prefixes before and
// suffixes behind the names of both; instances whose soft body has a name of one letter end with the separator.
int FindNumeric(const mjModel* m, int instance, const char* key) {
  const std::string soft = m->names + m->name_pluginadr[instance], own = std::string(":") + key;
  for (int i = 0; i < m->nnumeric; i++) {
    std::string name = m->names + m->name_numericadr[i];
    const size_t at = name.rfind(own);
    if (at == std::string::npos) continue;
    name.erase(at + 1, own.size() - 1);
    if (name == soft || name.erase(at, 1) == soft) return i;
  }
  return -1;
}

int FindSized(const mjModel* m, int instance, const char* key, int size, Reader* reader) {
  const int numeric = FindNumeric(m, instance, key);
  if (numeric >= 0 && m->numeric_size[numeric] != size) {
    reader->Fail(std::string("its numeric '") + key + "' has " + std::to_string(m->numeric_size[numeric]) +
                 " values, but has to have " + std::to_string(size));
  }
  return numeric;
}

}  // namespace

ScalingReader::ScalingReader(const mjModel* m, int instance, int materials, Reader* reader)
    : stiffness_(FindSized(m, instance, "stiffness", materials, reader)),
      damping_(FindSized(m, instance, "damping", 2, reader)) {
  read_.stiffness.assign(materials, 1.0);
}

const Scaling& ScalingReader::Read(const mjModel* m) {
  for (size_t i = 0; i < read_.stiffness.size(); i++) {
    read_.stiffness[i] = Checked(m, stiffness_, static_cast<int>(i));
  }
  read_.alpha = Checked(m, damping_, 0);
  read_.beta = Checked(m, damping_, 1);
  return read_;
}

double ScalingReader::Checked(const mjModel* m, int numeric, int entry) {
  if (numeric < 0) return 1;
  const double factor = m->numeric_data[m->numeric_adr[numeric] + entry];
  if (factor > 0 && std::isfinite(factor)) return factor;
  if (!told_) {
    mju_warning("mjframes: numeric '%s' is %g, but has to be a positive factor: it counts as 1.",
                m->names + m->name_numericadr[numeric], factor);
  }
  told_ = true;
  return 1;
}

}  // namespace mjframes
