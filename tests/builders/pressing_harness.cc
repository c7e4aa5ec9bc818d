// What presses where (pressing.h) as a C function.

#include <vector>

#include "pressing.h"

extern "C" __attribute__((visibility("default"))) void press(const double* C, const double* gap, int n, double load,
                                                             double* f) {
  std::vector<double> work(4 * n);
  mjframes::Press(C, gap, n, load, f, work.data());
}
