/// @file publisher_lcm.hpp -- a Publisher on an LCM that others of the same process may share (memq:// reaches nobody else).
#pragma once

#include <memory>

#include <lcm/lcm-cpp.hpp>

#include "publisher.hpp"

namespace lpvguard_sim {

/// take() also calls whoever else has subscribed there. Throws std::runtime_error when commands cannot be subscribed to.
std::unique_ptr<Publisher> publisher_on(std::shared_ptr<lcm::LCM> lcm);

}  // namespace lpvguard_sim
