// four.hpp -- vectors and symmetric matrices of four numbers, in double: what the second reckoning of the diagnosis needs. Eigen's
// decompositions took four fifths of what that test takes to compile.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace four {

constexpr std::size_t n = 4;
using Vector = std::array<double, n>;

inline Vector plus(const Vector& a, const Vector& b, double factor = 1.0) {  // a + factor b
    Vector c = a;
    for (std::size_t i = 0; i < n; ++i) {
        c[i] += factor * b[i];
    }
    return c;
}

inline double dot(const Vector& a, const Vector& b) {
    double all = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        all += a[i] * b[i];
    }
    return all;
}

// By rows.
using Matrix = std::array<Vector, n>;

inline Matrix plus(const Matrix& A, const Matrix& B, double factor = 1.0) {  // A + factor B
    Matrix C;
    for (std::size_t i = 0; i < n; ++i) {
        C[i] = plus(A[i], B[i], factor);
    }
    return C;
}

inline Matrix outer(const Vector& a) {  // a a'
    Matrix C;
    for (std::size_t i = 0; i < n; ++i) {
        C[i] = plus(Vector{}, a, a[i]);
    }
    return C;
}

inline Vector product(const Matrix& A, const Vector& b) {
    Vector c;
    for (std::size_t i = 0; i < n; ++i) {
        c[i] = dot(A[i], b);
    }
    return c;
}

// By A = L L'. A is positive definite, else the result is no number.
inline Matrix inverse(const Matrix& A) {
    Matrix L{}, inverted{};
    for (std::size_t j = 0; j < n; ++j) {
        for (std::size_t i = j; i < n; ++i) {
            double rest = A[i][j];
            for (std::size_t k = 0; k < j; ++k) {
                rest -= L[i][k] * L[j][k];
            }
            L[i][j] = i == j ? std::sqrt(rest) : rest / L[j][j];
        }
    }
    for (std::size_t column = 0; column < n; ++column) {
        Vector x{};
        for (std::size_t i = 0; i < n; ++i) {
            double rest = i == column ? 1.0 : 0.0;
            for (std::size_t k = 0; k < i; ++k) {
                rest -= L[i][k] * x[k];
            }
            x[i] = rest / L[i][i];
        }
        for (std::size_t i = n; i-- > 0;) {
            for (std::size_t k = i + 1; k < n; ++k) {
                x[i] -= L[k][i] * x[k];
            }
            x[i] /= L[i][i];
        }
        for (std::size_t i = 0; i < n; ++i) {
            inverted[i][column] = x[i];
        }
    }
    return inverted;
}

// Smallest and largest eigenvalue of a symmetric matrix, by Jacobi's rotations.
inline std::array<double, 2> extremes(Matrix A) {
    for (int sweep = 0; sweep < 30; ++sweep) {
        for (std::size_t p = 0; p < n; ++p) {
            for (std::size_t q = p + 1; q < n; ++q) {
                if (A[p][q] == 0.0) {
                    continue;
                }
                const double half = 0.5 * (A[q][q] - A[p][p]) / A[p][q];
                const double t = (half < 0.0 ? -1.0 : 1.0) / (std::abs(half) + std::sqrt(half * half + 1.0));
                const double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
                for (std::size_t k = 0; k < n; ++k) {
                    const double row = A[p][k];
                    A[p][k] = c * row - s * A[q][k];
                    A[q][k] = s * row + c * A[q][k];
                }
                for (std::size_t k = 0; k < n; ++k) {
                    const double column = A[k][p];
                    A[k][p] = c * column - s * A[k][q];
                    A[k][q] = s * column + c * A[k][q];
                }
                A[p][q] = A[q][p] = 0.0;
            }
        }
    }
    std::array<double, 2> found{std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};
    for (std::size_t i = 0; i < n; ++i) {
        found = {std::min(found[0], A[i][i]), std::max(found[1], A[i][i])};
    }
    return found;
}

}  // namespace four
