// What presses where, if all that is known is how much: the force f_t on each of n places of an elastic surface below
// something of a given shape.
//
//   min ½ fᵀ C f + gᵀ f   over f ≥ 0, Σ f = load
//
// C_ts is how far place t gives way to a unit force on s, g_t how far the shape is from t. Where f_t > 0 the gap is
// closed: (C f)_t + g_t = λ, by how much the shape comes nearer; elsewhere it is open, ≥ λ.
// By Polonsky and Keer's conjugate gradients (Wear 231, 1999).

#ifndef MJFRAMES_PLUGIN_PRESSING_H_
#define MJFRAMES_PLUGIN_PRESSING_H_

namespace mjframes {

// Fills in f (n) and returns λ.  C: n × n; gap: n; work: 4n.
double Press(const double* C, const double* gap, int n, double load, double* f, double* work);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PRESSING_H_
