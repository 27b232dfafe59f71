// Eight floats at once, in registers of AVX2 or in what an older processor has.
#pragma once
#include <cstddef>
#include <cstdint>
#ifdef __AVX2__
#include <immintrin.h>
#endif

namespace toile::stereo {

using Floats = float __attribute__((vector_size(32)));
using Ints = std::int32_t __attribute__((vector_size(32)));
using Words = std::uint32_t __attribute__((vector_size(32)));

inline Floats all(float x) { return Floats{x, x, x, x, x, x, x, x}; }

/// a b + c, rounded once where the processor can.
inline Floats fma(Floats a, Floats b, Floats c) {
#ifdef __FMA__
    return _mm256_fmadd_ps(a, b, c);
#else
    return a * b + c;
#endif
}

/// words[at].
inline Words gather(const std::uint32_t* words, Ints at) {
#ifdef __AVX2__
    return (Words)_mm256_i32gather_epi32(reinterpret_cast<const int*>(words), (__m256i)at, 4);
#else
    Words found;
    for (std::size_t k = 0; k < 8; ++k) found[k] = words[at[k]];
    return found;
#endif
}

/// Towards zero.
inline Ints truncated(Floats x) { return __builtin_convertvector(x, Ints); }

inline Floats as_floats(Ints x) { return __builtin_convertvector(x, Floats); }
inline Floats as_floats(Words below_2_31) { return as_floats((Ints)below_2_31); }

/// Into 0 to `most`; not a number becomes 0.
inline Floats clamped(Floats x, float most) {
#ifdef __AVX2__
    return _mm256_min_ps(_mm256_max_ps(x, all(0)), all(most));
#else
    x = x > 0.0F ? x : all(0);
    return x < most ? x : all(most);
#endif
}

/// Eight samples' sum in a fixed order.
inline float sum(Floats x) {
    const Floats half = x + __builtin_shufflevector(x, x, 4, 5, 6, 7, 0, 1, 2, 3);
    const Floats pair = half + __builtin_shufflevector(half, half, 2, 3, 0, 1, 6, 7, 4, 5);
    return pair[0] + pair[1];
}

}  // namespace toile::stereo
