// Compiles a hot loop twice, for every x86-64 processor and for those with AVX2 and FMA; the loader chooses. Where
// eight lanes pay off a function is written three times instead: MJFRAMES_TARGET names the processors of a version of
// it.

#ifndef MJFRAMES_PLUGIN_MULTIVERSION_H_
#define MJFRAMES_PLUGIN_MULTIVERSION_H_

// GCC 11 knows no arch=x86-64-v3 here. Sanitizers instrument the loader's choice function before they are ready for it.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && __GNUC__ >= 12 && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && !defined(MJFRAMES_SANITIZE)
#define MJFRAMES_MULTIVERSION __attribute__((target_clones("default", "arch=x86-64-v3")))
#define MJFRAMES_TARGET(name) __attribute__((target(name)))
#else
#define MJFRAMES_MULTIVERSION
#endif

#endif  // MJFRAMES_PLUGIN_MULTIVERSION_H_
