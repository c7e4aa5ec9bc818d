// Which vector units the processor has, and the system saves. Asked of the processor itself: the run-time library that
// zig links into portable builds says no to every name of __builtin_cpu_supports.

#ifndef MJFRAMES_PLUGIN_PROCESSOR_H_
#define MJFRAMES_PLUGIN_PROCESSOR_H_

#ifdef __x86_64__

#include <cpuid.h>

// The levels v3 and v4 of the x86-64 psABI, beyond the baseline. Listed, as zig's own list of features switches off
// again what a name like arch=x86-64-v3 brings.
#define MJFRAMES_AVX2 "sse4.2,popcnt,movbe,avx,avx2,f16c,fma,bmi,bmi2,lzcnt"
#define MJFRAMES_AVX512 MJFRAMES_AVX2 ",avx512f,avx512bw,avx512cd,avx512dq,avx512vl"

namespace mjframes {

inline bool HasAll(unsigned flags, unsigned wanted) { return (flags & wanted) == wanted; }

// Whether the system saves these parts of the registers, by their bits in XCR0.
inline bool SystemSaves(unsigned parts) {
  unsigned low, high;
  __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return HasAll(low, parts);
}

// What MJFRAMES_AVX2 and MJFRAMES_AVX512 list.

inline bool FindAvx2() {
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d)) return false;
  constexpr unsigned kOfLeaf1 = bit_SSE4_2 | bit_POPCNT | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C | bit_FMA;
  if (!HasAll(c, kOfLeaf1) || !SystemSaves(0x06)) return false;  // SSE and AVX registers
  if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !HasAll(b, bit_AVX2 | bit_BMI | bit_BMI2)) return false;
  return __get_cpuid(0x80000001, &a, &b, &c, &d) && HasAll(c, bit_LZCNT);
}

inline bool FindAvx512() {
  unsigned a, b, c, d;
  if (!FindAvx2() || !SystemSaves(0xe6)) return false;  // and AVX-512's masks and registers
  constexpr unsigned kOfLeaf7 = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
  return __get_cpuid_count(7, 0, &a, &b, &c, &d) && HasAll(b, kOfLeaf7);
}

inline const bool kHasAvx2 = FindAvx2();
inline const bool kHasAvx512 = FindAvx512();

}  // namespace mjframes

#endif  // __x86_64__

#endif  // MJFRAMES_PLUGIN_PROCESSOR_H_
