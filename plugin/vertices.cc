#include "vertices.h"

#include "simd.h"

namespace mjframes {
namespace {

// Blend for `Blocks` registers of vertices from s on.
template <typename V, int Blocks>
MJFRAMES_INLINE void BlendSome(const double* weight, const int32_t* point, size_t points, const Vec3* x, int n, int s,
                               bool adds, double* out) {
  constexpr int kSums = 3 * Blocks;
  V sum[kSums];
  const auto place = [=](int i) { return out + i / Blocks * n + s + kWidth<V> * (i % Blocks); };
  MJFRAMES_UNROLL
  for (int i = 0; i < kSums; i++) sum[i] = adds ? Load<V>(place(i)) : V{};
  for (size_t a = 0; a < points; a++) {
    const Vec3& position = x[point[a]];
    MJFRAMES_UNROLL
    for (int i = 0; i < kSums; i++) {
      sum[i] += Load<V>(weight + a * n + s + kWidth<V> * (i % Blocks)) * position[i / Blocks];
    }
  }
  MJFRAMES_UNROLL
  for (int i = 0; i < kSums; i++) Store(sum[i], place(i));
}

// out[c n + s] = Σ_a weight[a n + s] x[point[a]][c], or `adds` that to it
void Blend(const double* weight, const int32_t* point, size_t points, const Vec3* x, int n, bool adds, double* out) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    constexpr int kBlocks = 3;  // their nine sums stay in registers
    int s = 0;
    for (; s + kBlocks * kWidth<V> <= n; s += kBlocks * kWidth<V>) {
      BlendSome<V, kBlocks>(weight, point, points, x, n, s, adds, out);
    }
    for (; s + kLanes <= n; s += kLanes) BlendSome<Lanes, 1>(weight, point, points, x, n, s, adds, out);
    for (; s < n; s++) {
      for (int c = 0; c < 3; c++) {
        double sum = adds ? out[c * n + s] : 0;
        for (size_t a = 0; a < points; a++) sum += weight[a * n + s] * x[point[a]][c];
        out[c * n + s] = sum;
      }
    }
  });
}

}  // namespace

void SkinVertices(const Patch& patch, const Vec3* x, const Mat3& axes, double* out) {
  const int n = patch.vertices;
  Blend(patch.weight.data(), patch.point.data(), patch.point.size(), x, n, false, out);
  if (patch.offset.empty()) return;
  const Mat3 turned = Transpose(axes);
  const Vec3 axis[3] = {
      {turned[0], turned[1], turned[2]}, {turned[3], turned[4], turned[5]}, {turned[6], turned[7], turned[8]}};
  constexpr int32_t kAxes[3] = {0, 1, 2};
  Blend(patch.offset.data(), kAxes, 3, axis, n, true, out);
}

AlignedBox BoxAround(const double* vertices, int n) {
  AlignedBox box;
  for (int c = 0; c < 3; c++) {
    const Extremes of = ExtremesOf(vertices + c * n, n);
    box.centre[c] = 0.5 * (of.least + of.largest);
    box.half[c] = 0.5 * (of.largest - of.least);
  }
  return box;
}

const double* Boxes::SquaresTo(const Vec3& p) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    for (size_t i = 0; i < padded_; i += kWidth<V>) {
      V sum = Fill<V>(0);
      for (int c = 0; c < 3; c++) {
        const double* least = bounds_.data() + (2 * c) * padded_ + i;
        const V below = Load<V>(least) - p[c], above = p[c] - Load<V>(least + padded_);
        V far = below > above ? below : above;
        far = far > 0.0 ? far : Fill<V>(0);
        sum += far * far;
      }
      Store(sum, square_.data() + i);
    }
  });
  return square_.data();
}

int NearestVertex(const double* vertices, int n, const Vec3& p, double* square) {
  int nearest = -1;
  double best = *square;
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    V least = Fill<V>(best), first = Fill<V>(0);  // squares, and the number of the first of a register
    int s = 0;
    for (; s + kWidth<V> <= n; s += kWidth<V>) {
      const V x = Load<V>(vertices + s) - p[0], y = Load<V>(vertices + n + s) - p[1];
      const V z = Load<V>(vertices + 2 * n + s) - p[2];
      const V far = x * x + y * y + z * z;
      first = far < least ? Fill<V>(s) : first;
      least = far < least ? far : least;
    }
    for (int lane = 0; lane < kWidth<V>; lane++) {
      if (!(least[lane] < best)) continue;
      best = least[lane];
      nearest = static_cast<int>(first[lane]) + lane;
    }
    for (; s < n; s++) {
      const Vec3 offset = Vertex(vertices, n, s) - p;
      if (!(Dot(offset, offset) < best)) continue;
      best = Dot(offset, offset);
      nearest = s;
    }
  });
  *square = best;
  return nearest;
}

}  // namespace mjframes
