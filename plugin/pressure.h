// How points that touch within one cluster share its contact: a_s = max(0, 1 − (d_s − min d) / reach)², over their sum.

#ifndef MJFRAMES_PLUGIN_PRESSURE_H_
#define MJFRAMES_PLUGIN_PRESSURE_H_

namespace mjframes {

// Turns the distances of a cluster into shares in its contact, which sum to 1: those that are `reach` above the deepest
// have none. Returns the distance of the pressure centre; mjMAXVAL and no shares if nothing is near.
double ShareOut(double* distance, int begin, int end, double reach);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PRESSURE_H_
