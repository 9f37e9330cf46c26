// eigen.hpp -- Eigen without packets (vector instructions). A packet adds numbers in another order than scalar code. With packets, a
// model of four states would have other last bits on a host with SSE than on an ECU without SSE.
#pragma once

#ifndef EIGEN_DONT_VECTORIZE
#define EIGEN_DONT_VECTORIZE
#endif
#include <Eigen/Core>
