// How many fused multiply-adds a second one core can do: independent chains in registers.
#include <cstddef>

#if defined(__AVX512F__)
constexpr int BYTES = 64;
#elif defined(__AVX__)
constexpr int BYTES = 32;
#else
constexpr int BYTES = 16;
#endif
constexpr int CHAINS = 12;  // more than latency times units: 4 cycles, 2 units
typedef REAL V __attribute__((vector_size(BYTES)));

// Returns the number of multiply-adds of single numbers that it did.
extern "C" double multiply_add(std::size_t rounds, REAL factor, REAL addend, REAL *out) {
    const V a = V{} + factor, b = V{} + addend;
    V chain[CHAINS];
    for (int k = 0; k < CHAINS; ++k) chain[k] = V{} + REAL(k);
    for (std::size_t i = 0; i < rounds; ++i)
#pragma GCC unroll 16
        for (int k = 0; k < CHAINS; ++k) chain[k] = chain[k] * a + b;
    V total = V{};
    for (int k = 0; k < CHAINS; ++k) total += chain[k];
    *out = total[0];
    return double(rounds) * CHAINS * (BYTES / sizeof(REAL));
}
