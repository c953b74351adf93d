// F of a body by libformfactor, frequency by frequency: its own function, called without Python.
#include <complex>
#include <cstddef>

using Complex = std::complex<double>;

namespace {

// Of libformfactor 0.5, whose headers BornAgain's wheel leaves out.
struct Vector {
    Complex x, y, z;
};
using FormFactor = Complex (*)(const void* body, const Vector& q);

constexpr double TURN = 6.283185307179586476925286766559;

} // namespace

// The library has exp(+i q.r) and its origin at the centre of mass, `centre` above the bottom.
extern "C" void form_factor(FormFactor function, const void* body, double centre, std::size_t count,
                            const double* nu, Complex* values)
{
    for (std::size_t k = 0; k < count; ++k, nu += 3) {
        const Vector q{-TURN * nu[0], -TURN * nu[1], -TURN * nu[2]};
        values[k] = function(body, q) * std::polar(1.0, -TURN * nu[2] * centre);
    }
}
