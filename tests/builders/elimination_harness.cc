// A symmetric matrix that is eliminated, as a C function, for ctypes.

#include <algorithm>
#include <vector>

#include "elimination.h"

using namespace mjframes;

// x = matrix⁻¹ x, of a matrix (n × n) known up to the diagonal from where its rows begin; whether that is possible.
extern "C" __attribute__((visibility("default"))) int solve(int n, const double* matrix, int* begin, double* x) {
  std::vector<double> rows(Envelope::Entries(n)), memory(Envelope::Memory(n));
  const Envelope envelope = {n, rows.data(), memory.data(), begin};
  for (int k = 0; k < n; k++) std::copy_n(matrix + static_cast<size_t>(n) * k, k + 1, envelope.Row(k));
  return envelope.Solve(x);
}
