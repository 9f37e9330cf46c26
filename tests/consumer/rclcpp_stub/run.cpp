// run.cpp -- runs the node of tools/examples/ros2 under the stub. Standard input: rows of time, speed, angle, yaw rate and whether
// the messages arrive. Standard output: time, level, text of each diagnostic.
#include "monitor_node.cpp"

int main() {
    auto node = std::make_shared<MonitorNode>();
    if (node->on_configure({}) != MonitorNode::Result::SUCCESS || node->on_activate({}) != MonitorNode::Result::SUCCESS) {
        return 1;
    }
    using Twists = std::shared_ptr<rclcpp::Subscription<TwistStamped>>;
    using Drives = std::shared_ptr<rclcpp::Subscription<AckermannDriveStamped>>;
    const auto twists = std::any_cast<Twists>(node->subscriptions.at("/vehicle/twist"));
    const auto drives = std::any_cast<Drives>(node->subscriptions.at("/vehicle/drive"));
    double t, speed, angle, yaw_rate;
    int arrives;
    while (std::scanf("%lf %lf %lf %lf %d", &t, &speed, &angle, &yaw_rate, &arrives) == 5) {
        node->now_ns = static_cast<int64_t>(t * 1e9 + 0.5);
        if (arrives != 0) {
            auto twist = std::make_shared<TwistStamped>();
            twist->header.stamp = node->now();
            twist->twist.linear.x = speed;
            twist->twist.angular.z = yaw_rate;
            twists->receive(twist);
            auto drive = std::make_shared<AckermannDriveStamped>();
            drive->header.stamp = node->now();
            drive->drive.steering_angle = static_cast<float>(angle);
            drives->receive(drive);
        }
        if (auto timer = node->timer.lock()) {
            timer->fire();
        }
    }
    (void)node->on_deactivate({});
    if (!node->timer.expired()) {
        return 2;
    }
    for (const DiagnosticArray& message : node->diagnostics->sent) {
        const rclcpp::Time time(message.header.stamp);
        const DiagnosticStatus& status = message.status.front();
        std::printf("%lld %d %s|", static_cast<long long>(time.nanoseconds()), status.level, status.message.c_str());
        for (const diagnostic_msgs::msg::KeyValue& one : status.values) {
            std::printf("%s=%s;", one.key.c_str(), one.value.c_str());
        }
        std::printf("\n");
    }
    return 0;
}
