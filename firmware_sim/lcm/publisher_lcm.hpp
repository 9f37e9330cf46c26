/// @file publisher_lcm.hpp -- a Publisher on an LCM object that other code of the same process may share (memq:// needs this).
#pragma once

#include <memory>

#include <lcm/lcm-cpp.hpp>

#include "publisher.hpp"

namespace lpvguard_sim {

/// take() also calls other subscribers of this object. Throws std::runtime_error if commands cannot be subscribed to.
std::unique_ptr<Publisher> publisher_on(std::shared_ptr<lcm::LCM> lcm);

}  // namespace lpvguard_sim
