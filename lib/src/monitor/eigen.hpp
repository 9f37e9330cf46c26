// eigen.hpp -- Eigen as the core uses it: without packets. A packet's sum has another order than a scalar one, and a model of four
// states would give other last bits on a host with SSE than on an ECU without.
#pragma once

#ifndef EIGEN_DONT_VECTORIZE
#define EIGEN_DONT_VECTORIZE
#endif
#include <Eigen/Core>
