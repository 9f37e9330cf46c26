// stub.hpp -- a stub of the interface of rclcpp that tools/examples/ros2 uses. It is no ROS: one process, one clock that the
// test sets, no executor. Every header of ROS that the node includes is one line that includes this file.
#pragma once
#include <any>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace builtin_interfaces::msg {
struct Time {
    int32_t sec = 0;
    uint32_t nanosec = 0;
};
}  // namespace builtin_interfaces::msg
namespace std_msgs::msg {
struct Header {
    builtin_interfaces::msg::Time stamp;
    std::string frame_id;
};
}  // namespace std_msgs::msg
namespace geometry_msgs::msg {
struct Vector3 {
    double x = 0, y = 0, z = 0;
};
struct Twist {
    Vector3 linear, angular;
};
struct TwistStamped {
    using ConstSharedPtr = std::shared_ptr<const TwistStamped>;
    std_msgs::msg::Header header;
    Twist twist;
};
}  // namespace geometry_msgs::msg
namespace ackermann_msgs::msg {
struct AckermannDrive {
    float steering_angle = 0, steering_angle_velocity = 0, speed = 0, acceleration = 0, jerk = 0;
};
struct AckermannDriveStamped {
    using ConstSharedPtr = std::shared_ptr<const AckermannDriveStamped>;
    std_msgs::msg::Header header;
    AckermannDrive drive;
};
}  // namespace ackermann_msgs::msg
namespace diagnostic_msgs::msg {
struct KeyValue {
    std::string key, value;
};
struct DiagnosticStatus {
    static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2, STALE = 3;
    unsigned char level = 0;
    std::string name, message, hardware_id;
    std::vector<KeyValue> values;
};
struct DiagnosticArray {
    std_msgs::msg::Header header;
    std::vector<DiagnosticStatus> status;
};
}  // namespace diagnostic_msgs::msg

namespace rclcpp {
struct Duration {
    int64_t ns;
    int64_t nanoseconds() const { return ns; }
};
class Time {
public:
    explicit Time(int64_t ns) : ns_(ns) {}
    Time(const builtin_interfaces::msg::Time& stamp) : ns_(stamp.sec * INT64_C(1000000000) + stamp.nanosec) {}
    operator builtin_interfaces::msg::Time() const {
        return {static_cast<int32_t>(ns_ / 1000000000), static_cast<uint32_t>(ns_ % 1000000000)};
    }
    int64_t nanoseconds() const { return ns_; }
    Duration operator-(const Time& other) const { return {ns_ - other.ns_}; }

private:
    int64_t ns_;
};
struct NodeOptions {};
struct SensorDataQoS {};
struct Logger {};
class Parameter {
public:
    explicit Parameter(std::any value = {}) : value_(std::move(value)) {}
    double as_double() const { return std::any_cast<double>(value_); }
    std::string as_string() const { return std::any_cast<const char*>(value_); }

private:
    std::any value_;
};
template <typename Message>
struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(std::shared_ptr<const Message>)> receive;
};
struct TimerBase {
    using SharedPtr = std::shared_ptr<TimerBase>;
    std::function<void()> fire;
    std::chrono::microseconds period;
};
}  // namespace rclcpp
#define RCLCPP_ERROR(logger, text) (static_cast<void>(logger), std::fprintf(stderr, "%s\n", text))
#define RCLCPP_COMPONENTS_REGISTER_NODE(type)

namespace rclcpp_lifecycle {
struct State {};
namespace node_interfaces {
struct LifecycleNodeInterface {
    enum class CallbackReturn {
        SUCCESS,
        FAILURE,
        ERROR
    };
};
}  // namespace node_interfaces
template <typename Message>
struct LifecyclePublisher {
    using SharedPtr = std::shared_ptr<LifecyclePublisher>;
    bool active = false;
    std::vector<Message> sent;
    void publish(const Message& message) {
        if (active) {
            sent.push_back(message);
        }
    }
};
class LifecycleNode {
public:
    using CallbackReturn = node_interfaces::LifecycleNodeInterface::CallbackReturn;
    LifecycleNode(const std::string&, const rclcpp::NodeOptions&) {}
    virtual ~LifecycleNode() = default;
    virtual CallbackReturn on_configure(const State&) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const State&) {
        diagnostics->active = true;
        return CallbackReturn::SUCCESS;
    }
    virtual CallbackReturn on_deactivate(const State&) {
        diagnostics->active = false;
        return CallbackReturn::SUCCESS;
    }
    template <typename T>
    void declare_parameter(const std::string& name, T value) {
        parameters_[name] = rclcpp::Parameter(value);
    }
    rclcpp::Parameter get_parameter(const std::string& name) const { return parameters_.at(name); }
    rclcpp::Logger get_logger() const { return {}; }
    rclcpp::Time now() const { return rclcpp::Time(now_ns); }
    template <typename Message>
    typename LifecyclePublisher<Message>::SharedPtr create_publisher(const std::string&, int) {
        return diagnostics = std::make_shared<LifecyclePublisher<Message>>();
    }
    template <typename Message, typename Callback>
    typename rclcpp::Subscription<Message>::SharedPtr create_subscription(const std::string& topic, rclcpp::SensorDataQoS, Callback call) {
        auto made = std::make_shared<rclcpp::Subscription<Message>>();
        made->receive = call;
        subscriptions[topic] = made;
        return made;
    }
    template <typename Callback>
    rclcpp::TimerBase::SharedPtr create_wall_timer(std::chrono::microseconds period, Callback call) {
        auto made = std::make_shared<rclcpp::TimerBase>(rclcpp::TimerBase{call, period});
        timer = made;
        return made;
    }
    // What the test reads and sets.
    int64_t now_ns = 0;
    std::shared_ptr<LifecyclePublisher<diagnostic_msgs::msg::DiagnosticArray>> diagnostics;
    std::map<std::string, std::any> subscriptions;
    std::weak_ptr<rclcpp::TimerBase> timer;

private:
    std::map<std::string, rclcpp::Parameter> parameters_;
};
}  // namespace rclcpp_lifecycle
