#include "moved_points.h"

#include <algorithm>

#include "simd.h"
#include "weights.h"

namespace mjframes {
namespace {

constexpr int kBlock = 2 * kWideLanes;  // points whose coordinates a processor holds at once

}  // namespace

void PointWeights::Read(int count, const std::vector<int32_t>& also, Reader* reader) {
  const Weights sparse = ReadWeights(count, reader);
  point = sparse.point;
  point.insert(point.end(), also.begin(), also.end());
  const bool known = std::all_of(also.begin(), also.end(), [=](int32_t j) { return j >= 0 && j < count; });
  if (!reader->Check(known && !sparse.point.empty(), "its points are not those of the soft body: attach it again"))
    return;
  std::sort(point.begin(), point.end());
  point.erase(std::unique(point.begin(), point.end()), point.end());
  size = sparse.size();
  padded = (size + kBlock - 1) / kBlock * kBlock;
  offset = sparse.offset;
  weight.assign(padded * point.size(), 0.0);
  for (int n = 0; n < size; n++) {
    for (int32_t entry = sparse.first[n]; entry < sparse.first[n + 1]; entry++) {
      const size_t i = std::lower_bound(point.begin(), point.end(), sparse.point[entry]) - point.begin();
      weight[kBlock * (n / kBlock * point.size() + i) + n % kBlock] += sparse.weight[entry];
    }
  }
}

MovedPoints::MovedPoints(const PointWeights& weights)
    : weights_(weights), position_(3 * static_cast<size_t>(weights.padded)), gradient_(position_.size()) {}

void MovedPoints::Place(const std::vector<Vec3>& x, const Mat3& A) {
  const int padded = weights_.padded;
  const size_t count = weights_.point.size();
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    constexpr int kParts = kBlock / kWidth<V>;
    const double* w = weights_.weight.data();
    const Vec3* place = x.data();
    double* into = position_.data();
    for (int at = 0; at < padded; at += kBlock) {
      V sum[3][kParts] = {};
      for (size_t i = 0; i < count; i++, w += kBlock) {
        MJFRAMES_UNROLL
        for (int part = 0; part < kParts; part++) {
          const V some = Load<V>(w + kWidth<V> * part);
          for (int r = 0; r < 3; r++) sum[r][part] += some * place[i][r];
        }
      }
      for (int r = 0; r < 3; r++) {
        for (int part = 0; part < kParts; part++) {
          Store(sum[r][part], into + r * padded + at + kWidth<V> * part);
        }
      }
    }
  });
  for (size_t n = 0; n < weights_.offset.size(); n++) {
    const Vec3 turned = Mul(A, weights_.offset[n]);
    for (int r = 0; r < 3; r++) position_[r * padded + n] += turned[r];
  }
}

Vec3 MovedPoints::Gather(const Mat3& A, std::vector<Vec3>* G) const {
  const int padded = weights_.padded;
  const size_t count = weights_.point.size();
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    constexpr int kParts = kBlock / kWidth<V>;
    const double* g = gradient_.data();
    for (size_t i = 0; i < count; i++) {
      V sum[3][kParts] = {};
      const double* w = weights_.weight.data() + kBlock * i;
      for (int at = 0; at < padded; at += kBlock, w += kBlock * count) {
        MJFRAMES_UNROLL
        for (int part = 0; part < kParts; part++) {
          const V some = Load<V>(w + kWidth<V> * part);
          for (int r = 0; r < 3; r++) {
            sum[r][part] += some * Load<V>(g + r * padded + at + kWidth<V> * part);
          }
        }
      }
      for (int r = 0; r < 3; r++) {
        double total = 0;
        for (int part = 0; part < kParts; part++) {
          for (int lane = 0; lane < kWidth<V>; lane++) total += sum[r][part][lane];
        }
        (*G)[i][r] = total;
      }
    }
  });
  Vec3 torque{};
  for (size_t n = 0; n < weights_.offset.size(); n++) {
    torque = torque + Cross(Mul(A, weights_.offset[n]), At(gradient_, static_cast<int>(n)));
  }
  return torque;
}

}  // namespace mjframes
