// monitor_node.cpp -- a ROS 2 lifecycle node that runs a vehicle's nominal-error monitor.
//
// In:  /vehicle/twist  geometry_msgs/TwistStamped, speed and yaw rate
//      /vehicle/drive  ackermann_msgs/AckermannDriveStamped, road-wheel angle
// Out: /diagnostics    diagnostic_msgs/DiagnosticArray, at each change of the verdict and once a second
//
// The timer takes one sample per period. If a message is older than the parameter max_age_s, the sample is left out, and the monitor
// sees a gap. `lpvguard replay --as ros2` writes bags with the same topics.
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <ackermann_msgs/msg/ackermann_drive_stamped.hpp>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/twist_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>

#include "lpvguard/monitor.h"
#include "lpvguard_signals.h"

using ackermann_msgs::msg::AckermannDriveStamped;
using diagnostic_msgs::msg::DiagnosticArray;
using diagnostic_msgs::msg::DiagnosticStatus;
using geometry_msgs::msg::TwistStamped;

class MonitorNode : public rclcpp_lifecycle::LifecycleNode {
public:
    using Result = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

    explicit MonitorNode(const rclcpp::NodeOptions& options = {}) : LifecycleNode("lpvguard_monitor", options) {
        declare_parameter("max_age_s", 0.1);
        declare_parameter("vehicle", "vehicle");
    }

    Result on_configure(const rclcpp_lifecycle::State&) override {
        max_age_ns_ = static_cast<int64_t>(get_parameter("max_age_s").as_double() * 1e9);
        vehicle_ = get_parameter("vehicle").as_string();
        diagnostics_ = create_publisher<DiagnosticArray>("/diagnostics", 10);
        twist_ = create_subscription<TwistStamped>("/vehicle/twist", rclcpp::SensorDataQoS(),
                                                   [this](TwistStamped::ConstSharedPtr message) { last_twist_ = message; });
        drive_ = create_subscription<AckermannDriveStamped>(
            "/vehicle/drive", rclcpp::SensorDataQoS(), [this](AckermannDriveStamped::ConstSharedPtr message) { last_drive_ = message; });
        if (lpvg_monitor_init(&monitor_, &lpvg_coeff) != lpvg_status_ok) {
            RCLCPP_ERROR(get_logger(), "the monitor refuses the linked coefficients");
            return Result::FAILURE;
        }
        return Result::SUCCESS;
    }

    Result on_activate(const rclcpp_lifecycle::State& state) override {
        // What came before the activation is no evidence.
        last_twist_ = nullptr;
        last_drive_ = nullptr;
        published_ = lpvg_verdict_unknown;
        published_us_ = -period_us_ * samples_per_second_;
        status_ = lpvg_monitor_init(&monitor_, &lpvg_coeff);
        timer_ = create_wall_timer(std::chrono::microseconds(period_us_), [this] { step(); });
        return LifecycleNode::on_activate(state);
    }

    Result on_deactivate(const rclcpp_lifecycle::State& state) override {
        timer_ = nullptr;
        return LifecycleNode::on_deactivate(state);
    }

private:
    template <typename Message>
    bool fresh(const std::shared_ptr<const Message>& message, const rclcpp::Time& time) const {
        return message != nullptr && (time - rclcpp::Time(message->header.stamp)).nanoseconds() <= max_age_ns_;
    }

    void step() {
        const rclcpp::Time time = now();
        const int64_t t_us = time.nanoseconds() / 1000;
        if (fresh(last_twist_, time) && fresh(last_drive_, time)) {
            lpvg_sample_t sample{};
            sample.t_us = t_us;
            sample.speed = static_cast<lpvg_real_t>(last_twist_->twist.linear.x);
            sample.u[LPVG_INPUT_ROAD_WHEEL_ANGLE] = static_cast<lpvg_real_t>(last_drive_->drive.steering_angle);
            sample.y[LPVG_OUTPUT_YAW_RATE] = static_cast<lpvg_real_t>(last_twist_->twist.angular.z);
            status_ = lpvg_monitor_push(&monitor_, &sample);
        }
        const lpvg_verdict_t verdict = lpvg_monitor_verdict(&monitor_, t_us);
        if (verdict != published_ || t_us - published_us_ >= period_us_ * samples_per_second_) {
            publish(verdict, time);
            published_ = verdict;
            published_us_ = t_us;
        }
    }

    void publish(lpvg_verdict_t verdict, const rclcpp::Time& time) {
        DiagnosticStatus status;
        status.name = "lpvguard: nominal model";
        status.hardware_id = vehicle_;
        switch (verdict) {
            case lpvg_verdict_valid: status.level = DiagnosticStatus::OK, status.message = "valid"; break;
            case lpvg_verdict_degraded: status.level = DiagnosticStatus::WARN, status.message = "degraded"; break;
            case lpvg_verdict_invalid: status.level = DiagnosticStatus::ERROR, status.message = "invalid"; break;
            case lpvg_verdict_fault: status.level = DiagnosticStatus::ERROR, status.message = "fault"; break;
            case lpvg_verdict_not_judged: status.level = DiagnosticStatus::STALE, status.message = "not judged"; break;
            case lpvg_verdict_stale: status.level = DiagnosticStatus::STALE, status.message = "stale"; break;
            default: status.level = DiagnosticStatus::STALE, status.message = "unknown"; break;
        }
        const auto add = [&status](const char* key, auto value) {
            diagnostic_msgs::msg::KeyValue one;
            one.key = key;
            one.value = std::to_string(value);
            status.values.push_back(one);
        };
        add("margin", monitor_.frame.margin);
        add("energy_ratio", monitor_.energy.ratio);
        add("change_ratio", monitor_.change.ratio);
        add("status of the newest sample", static_cast<int>(status_));
        DiagnosticArray message;
        message.header.stamp = time;
        message.status.push_back(status);
        diagnostics_->publish(message);
    }

    static constexpr int64_t second_us_ = 1000000;
    const int64_t period_us_ = lpvg_coeff.words.sample_period_us;
    const int64_t samples_per_second_ = second_us_ / period_us_;
    lpvg_monitor_t monitor_{};
    lpvg_status_t status_ = lpvg_status_ok;
    lpvg_verdict_t published_ = lpvg_verdict_unknown;
    int64_t published_us_ = 0, max_age_ns_ = 0;
    std::string vehicle_;
    TwistStamped::ConstSharedPtr last_twist_;
    AckermannDriveStamped::ConstSharedPtr last_drive_;
    rclcpp_lifecycle::LifecyclePublisher<DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::Subscription<TwistStamped>::SharedPtr twist_;
    rclcpp::Subscription<AckermannDriveStamped>::SharedPtr drive_;
    rclcpp::TimerBase::SharedPtr timer_;
};

RCLCPP_COMPONENTS_REGISTER_NODE(MonitorNode)
