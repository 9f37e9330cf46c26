// The publisher of a simulator without LCM (CMake: LPVG_BUILD_LCM off; default of `lpvguard sim`).
#include "arguments.hpp"
#include "publisher.hpp"

namespace lpvguard_sim {

std::unique_ptr<Publisher> open_publisher(const std::string& url) {
    throw lpvguard_plant::UsageError("--lcm '" + url + "': built without LCM; configure with -DLPVG_BUILD_LCM=ON");
}

}  // namespace lpvguard_sim
