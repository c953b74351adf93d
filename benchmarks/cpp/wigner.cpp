// W(x, nu) of one outline, hand-written: the yardstick of `make bench`. Not part of the package.
//
// The sum over edges of docs/theory.md, (W1). The outline comes as constants in a header that the
// benchmark writes, so that all that is known of it is folded by the compiler; `-DUNROLLED` makes
// code for every edge and side, without it both are loops over tables (the brute-force kernel).
// REAL is float or double. Vectors are as wide as the machine's: AVX-512, AVX2, or 16 bytes.
//
// DIRECTION[k]   unit vectors u_k, one for all parallel lines
// EDGE[e]        a_x, a_y, signed length along its direction;  EDGE_DIRECTION[e] = k
// SIDE[s]        offset h: a point p lies in the piece where sign (cross(u_k, p) - h) > 0;
//                SIDE_DIRECTION[s] = k, SIDE_SIGN[s] = sign;  FIRST_SIDE[l] of convex piece l

#include <cstddef>
#include <utility>

#if defined(__AVX512F__) || defined(__AVX__)
#include <immintrin.h>
#endif
#include OUTLINE

namespace {

#if defined(__AVX512F__)
constexpr int BYTES = 64;
#elif defined(__AVX__)
constexpr int BYTES = 32;
#else
constexpr int BYTES = 16;
#endif
constexpr bool SINGLE = sizeof(REAL) == 4;
constexpr int LANES = BYTES / sizeof(REAL);
constexpr double PI = 3.14159265358979323846;
constexpr double PARALLEL = 1e-9;  // sine below which an edge and a side count as parallel

typedef REAL V __attribute__((vector_size(BYTES)));
typedef REAL Unaligned __attribute__((vector_size(BYTES), aligned(sizeof(REAL))));

inline V splat(double c) { return V{} + REAL(c); }
inline V load(const REAL *p) { return *reinterpret_cast<const Unaligned *>(p); }
inline void store(REAL *p, V v) { *reinterpret_cast<Unaligned *>(p) = v; }

// The names of one type's instructions; `if constexpr` would need them for both types at once.
#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)
#define INTRINSIC(name) JOIN(name, SUFFIX)
#if defined(__AVX512F__)
inline V low(V a, V b) { return INTRINSIC(_mm512_min_)(a, b); }
inline V high(V a, V b) { return INTRINSIC(_mm512_max_)(a, b); }
inline V nearest(V a) { return INTRINSIC(_mm512_roundscale_)(a, 8); }
#elif defined(__AVX__)
inline V low(V a, V b) { return INTRINSIC(_mm256_min_)(a, b); }
inline V high(V a, V b) { return INTRINSIC(_mm256_max_)(a, b); }
inline V nearest(V a) { return INTRINSIC(_mm256_round_)(a, 8); }
#else
inline V low(V a, V b) { return a < b ? a : b; }
inline V high(V a, V b) { return a > b ? a : b; }
inline V nearest(V a) {  // needs strict arithmetic: no -ffast-math
    const V shift = splat(SINGLE ? 12582912.0 : 6755399441055744.0);
    return (a + shift) - shift;
}
#endif

// sin(2 pi t) = r (1/4 - r^2) Q(r^2), r = t - round(t): as short as the precision allows.
constexpr double Q_DOUBLE[] = {
    25.132741228718345, -64.83584404672554, 67.07762091738222,   -38.51295534186807,
    14.182954388478867, -3.646752364831226, 0.6927968586177335,  -0.10127479441363349,
    0.011700148974859654, -0.0010057071302593576};
constexpr double Q_SINGLE[] = {25.13274115471077,   -64.8358227214753,  67.07662306642158,
                               -38.495830637736184, 14.049443530985526, -3.1612498251959376};

inline V sin_turns(V turns) {
    const V r = turns - nearest(turns), square = r * r;
    constexpr int degree = SINGLE ? 5 : 9;
    const double *c = SINGLE ? Q_SINGLE : Q_DOUBLE;
    V q = splat(c[degree]);
#pragma GCC unroll 16
    for (int k = degree - 1; k >= 0; --k) q = q * square + splat(c[k]);
    return q * (splat(0.25) - square) * r;
}

constexpr double cross(double ax, double ay, double bx, double by) { return ax * by - ay * bx; }
constexpr int DIRECTIONS = sizeof(DIRECTION) / sizeof(DIRECTION[0]);
constexpr int EDGES = sizeof(EDGE) / sizeof(EDGE[0]);
constexpr int SIDES = sizeof(SIDE) / sizeof(SIDE[0]);
constexpr int PIECES = sizeof(FIRST_SIDE) / sizeof(FIRST_SIDE[0]) - 1;

struct Cut {  // t = slope * level + start where an edge meets a side of the mirrored copy
    double slope, start;
    bool parallel, rising;
};

constexpr Cut cut_of(int e, int s) {
    const auto &u = DIRECTION[SIDE_DIRECTION[s]];
    const auto &v = DIRECTION[EDGE_DIRECTION[e]];
    const double sine = cross(u[0], u[1], v[0], v[1]);
    const double from = cross(u[0], u[1], EDGE[e][0], EDGE[e][1]) + SIDE[s];
    if (sine < PARALLEL && sine > -PARALLEL) return {0, from, true, false};
    const double across = sine * EDGE[e][2];
    return {1 / across, -from / across, false, across * SIDE_SIGN[s] < 0};
}

struct Sample {  // what all edges share
    V x, y, nu_x, nu_y, nu_t;
    V level[DIRECTIONS], along[DIRECTIONS], ratio[DIRECTIONS];
};

inline Sample prepared(V x, V y, V nu_x, V nu_y) {
    constexpr double floor = SINGLE ? 1e-6 : 1e-9, least = SINGLE ? 1e-20 : 1e-30;
    const V zero = V{}, tiny = splat(floor);
    const auto is_zero = (nu_x < tiny) & (nu_x > -tiny) & (nu_y < tiny) & (nu_y > -tiny);
    Sample p;
    p.x = x + x, p.y = y + y;
    p.nu_x = is_zero ? tiny : nu_x, p.nu_y = is_zero ? zero : nu_y;
    p.nu_t = p.nu_x * p.x + p.nu_y * p.y;
#pragma GCC unroll 64
    for (int k = 0; k < DIRECTIONS; ++k) {
        const V ux = splat(DIRECTION[k][0]), uy = splat(DIRECTION[k][1]);
        p.level[k] = ux * p.y - uy * p.x;
        V along = p.nu_x * ux + p.nu_y * uy;
        const auto small = (along < splat(least)) & (along > splat(-least));
        along = small ? splat(least) : along;
        p.along[k] = along;
        p.ratio[k] = (p.nu_x * uy - p.nu_y * ux) / along;
    }
    return p;
}

inline V finished(const Sample &p, V total) {
    return total / (splat(PI * PI) * (p.nu_x * p.nu_x + p.nu_y * p.nu_y));
}

inline V part(V start, V q, V low_t, V high_t, V extent) {
    return sin_turns(extent * q) * sin_turns((low_t + high_t) * q + start);
}

#ifdef UNROLLED

template <int e, int s> inline void clip(const Sample &p, V &t0, V &t1) {
    constexpr Cut c = cut_of(e, s);
    if constexpr (!c.parallel) {
        const V t = p.level[SIDE_DIRECTION[s]] * splat(c.slope) + splat(c.start);
        if constexpr (c.rising) t0 = high(t0, t);
        else t1 = low(t1, t);
    }
}

template <int e, int s> inline V gated(const Sample &p, V extent) {
    constexpr Cut c = cut_of(e, s);
    if constexpr (c.parallel) {
        const V level = p.level[SIDE_DIRECTION[s]];
        if constexpr (SIDE_SIGN[s] > 0) extent = level > splat(c.start) ? extent : V{};
        else extent = level > splat(c.start) ? V{} : extent;
    }
    return extent;
}

template <int e, int l, std::size_t... k>
inline V in_piece(const Sample &p, V start, V q, std::index_sequence<k...>) {
    constexpr int first = FIRST_SIDE[l];
    V t0 = V{}, t1 = splat(1);
    (clip<e, first + int(k)>(p, t0, t1), ...);
    V extent = high(t1 - t0, V{});
    ((extent = gated<e, first + int(k)>(p, extent)), ...);
    return part(start, q, t0, t1, extent);
}

template <int e, std::size_t... l> inline V of_edge(const Sample &p, std::index_sequence<l...>) {
    constexpr int k = EDGE_DIRECTION[e];
    const V q = p.along[k] * splat(EDGE[e][2]);
    const V start = p.nu_x * splat(2 * EDGE[e][0]) + (p.nu_y * splat(2 * EDGE[e][1]) - p.nu_t);
    V total = V{};
    ((total += in_piece<e, int(l)>(
          p, start, q, std::make_index_sequence<FIRST_SIDE[l + 1] - FIRST_SIDE[l]>{})),
     ...);
    return p.ratio[k] * total;
}

template <std::size_t... e> inline V all_edges(const Sample &p, std::index_sequence<e...>) {
    V total = V{};
    ((total += of_edge<int(e)>(p, std::make_index_sequence<PIECES>{})), ...);
    return total;
}

inline V value(const Sample &p) { return all_edges(p, std::make_index_sequence<EDGES>{}); }

#else

struct Table {
    REAL slope[EDGES][SIDES], start[EDGES][SIDES];
    signed char kind[EDGES][SIDES];  // 1 rising, 0 falling, 2 and 3 parallel

    Table() {
        for (int e = 0; e < EDGES; ++e)
            for (int s = 0; s < SIDES; ++s) {
                const Cut c = cut_of(e, s);
                slope[e][s] = REAL(c.slope), start[e][s] = REAL(c.start);
                kind[e][s] = c.parallel ? (SIDE_SIGN[s] > 0 ? 2 : 3) : c.rising;
            }
    }
};
const Table TABLE;

inline V value(const Sample &p) {
    V total = V{};
    for (int e = 0; e < EDGES; ++e) {
        const int k = EDGE_DIRECTION[e];
        const V q = p.along[k] * splat(EDGE[e][2]);
        const V start = p.nu_x * splat(2 * EDGE[e][0]) + (p.nu_y * splat(2 * EDGE[e][1]) - p.nu_t);
        V sum = V{};
        for (int l = 0; l < PIECES; ++l) {
            V t0 = V{}, t1 = splat(1);
            for (int s = FIRST_SIDE[l]; s < FIRST_SIDE[l + 1]; ++s) {
                const V level = p.level[SIDE_DIRECTION[s]];
                const REAL from = TABLE.start[e][s];
                const V t = level * TABLE.slope[e][s] + from;
                switch (TABLE.kind[e][s]) {  // the same for all samples: foreseen
                case 0: t1 = low(t1, t); break;
                case 1: t0 = high(t0, t); break;
                case 2: t1 = level > from ? t1 : t0 - splat(1); break;
                default: t1 = level > from ? t0 - splat(1) : t1;
                }
            }
            const V extent = high(t1 - t0, V{});
            bool any = false;
            for (int lane = 0; lane < LANES; ++lane) any |= extent[lane] > 0;
            if (any) sum += part(start, q, t0, t1, extent);
        }
        total += p.ratio[k] * sum;
    }
    return total;
}

#endif

}  // namespace

extern "C" void wigner(const REAL *x, const REAL *y, const REAL *nu_x, const REAL *nu_y, REAL *out,
                       std::size_t count) {
    std::size_t i = 0;
    for (; i + LANES <= count; i += LANES) {
        const Sample p = prepared(load(x + i), load(y + i), load(nu_x + i), load(nu_y + i));
        store(out + i, finished(p, value(p)));
    }
    if (i == count) return;
    REAL rest[5][LANES] = {};  // what is left, as one vector
    for (std::size_t k = 0; i + k < count; ++k)
        rest[0][k] = x[i + k], rest[1][k] = y[i + k], rest[2][k] = nu_x[i + k], rest[3][k] = nu_y[i + k];
    const Sample p = prepared(load(rest[0]), load(rest[1]), load(rest[2]), load(rest[3]));
    store(rest[4], finished(p, value(p)));
    for (std::size_t k = 0; i + k < count; ++k) out[i + k] = rest[4][k];
}
