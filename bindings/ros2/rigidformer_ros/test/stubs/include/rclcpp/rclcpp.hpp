// A stand-in for the parts of rclcpp that the node uses, with their names and signatures. Messages go from function to
// function in one process; rclcpp::stub is the test's side of them.
#pragma once

#include <any>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <builtin_interfaces/msg/time.hpp>
#include <rcl_interfaces/msg/parameter_descriptor.hpp>

// Of rcl/time.h.
typedef enum rcl_clock_type_e {
    RCL_CLOCK_UNINITIALIZED = 0,
    RCL_ROS_TIME,
    RCL_SYSTEM_TIME,
    RCL_STEADY_TIME
} rcl_clock_type_t;

namespace rclcpp {

namespace exceptions {
struct InvalidParameterTypeException : std::runtime_error {
    using std::runtime_error::runtime_error;
};
struct InvalidParameterValueException : std::runtime_error {
    using std::runtime_error::runtime_error;
};
struct ParameterAlreadyDeclaredException : std::runtime_error {
    using std::runtime_error::runtime_error;
};
}  // namespace exceptions

class Parameter {
public:
    using Value = std::variant<bool, std::int64_t, double, std::string, std::vector<double>,
                               std::vector<std::string>>;
    Parameter(std::string name, Value value) : name_(std::move(name)), value_(std::move(value)) {}
    // A literal is no bool.
    Parameter(std::string name, const char *value) : Parameter(std::move(name), std::string(value)) {}
    const std::string &get_name() const { return name_; }
    const Value &value() const { return value_; }

private:
    std::string name_;
    Value value_;
};

class ParameterValue {
public:
    explicit ParameterValue(Parameter::Value value) : value_(std::move(value)) {}
    const Parameter::Value &value() const { return value_; }

private:
    Parameter::Value value_;
};

namespace node_interfaces {
class NodeParametersInterface {
public:
    using SharedPtr = std::shared_ptr<NodeParametersInterface>;
    explicit NodeParametersInterface(const std::vector<Parameter> &overrides) {
        for (const Parameter &parameter : overrides) {
            overrides_.insert_or_assign(parameter.get_name(), ParameterValue(parameter.value()));
        }
    }
    // All that were given, whether declared or not.
    const std::map<std::string, ParameterValue> &get_parameter_overrides() const {
        return overrides_;
    }

private:
    std::map<std::string, ParameterValue> overrides_;
};
}  // namespace node_interfaces

class NodeOptions {
public:
    NodeOptions &parameter_overrides(std::vector<Parameter> overrides) {
        overrides_ = std::move(overrides);
        return *this;
    }
    const std::vector<Parameter> &parameter_overrides() const { return overrides_; }

private:
    std::vector<Parameter> overrides_;
};

class QoS {
public:
    QoS(std::size_t depth) : depth(depth) {}
    std::size_t depth;
};
class SensorDataQoS : public QoS {
public:
    SensorDataQoS() : QoS(5) {}
};

class Logger {
public:
    explicit Logger(std::string name) : name_(std::move(name)) {}
    const char *get_name() const { return name_.c_str(); }

private:
    std::string name_;
};
inline Logger get_logger(const std::string &name) { return Logger(name); }

class Node;

namespace stub {
struct Log {
    std::string level, logger, text;
};
struct World {
    // By topic: what was published, and who listens.
    std::map<std::string, std::vector<std::any>> published;
    std::map<std::string, std::vector<std::function<void(const std::any &)>>> listeners;
    std::vector<Log> logs;
    // What clocks tell: that of a node with use_sim_time, which stays at 0 until /clock is heard, and the steady one.
    std::int64_t ros_ns = 0, steady_ns = 1000000000000;
    // Of nodes that are made without options, as on a command line.
    std::vector<Parameter> arguments;
    // What happens while a node spins.
    std::function<void()> spinning;
    // What was declared, by the last node.
    std::map<std::string, rcl_interfaces::msg::ParameterDescriptor> declared;
};
inline World &world() {
    static World world;
    return world;
}
template <typename... Values>
void log(const char *level, const Logger &logger, const char *format, Values... values) {
    char text[1024];
    std::snprintf(text, sizeof text, format, values...);
    world().logs.push_back({level, logger.get_name(), text});
}
template <typename M>
void send(const std::string &topic, const M &message) {
    for (const auto &listener : world().listeners[topic]) listener(message);
}
template <typename M>
std::vector<M> published(const std::string &topic) {
    std::vector<M> all;
    for (const std::any &message : world().published[topic]) {
        all.push_back(std::any_cast<M>(message));
    }
    return all;
}
}  // namespace stub

class Duration {
public:
    static Duration from_seconds(double seconds) { return Duration(static_cast<std::int64_t>(seconds * 1e9)); }
    std::int64_t nanoseconds() const { return ns_; }

private:
    explicit Duration(std::int64_t ns) : ns_(ns) {}
    std::int64_t ns_;
};

class Time {
public:
    explicit Time(std::int64_t ns) : ns_(ns) {}
    Time(const builtin_interfaces::msg::Time &time) : ns_(std::int64_t{time.sec} * 1000000000 + time.nanosec) {}
    std::int64_t nanoseconds() const { return ns_; }

private:
    std::int64_t ns_;
};

class Clock {
public:
    using SharedPtr = std::shared_ptr<Clock>;
    explicit Clock(rcl_clock_type_t type = RCL_SYSTEM_TIME) : type_(type) {}
    Time now() const {
        return Time(type_ == RCL_STEADY_TIME ? stub::world().steady_ns : stub::world().ros_ns);
    }

private:
    rcl_clock_type_t type_;
};

template <typename M>
class Publisher {
public:
    using SharedPtr = std::shared_ptr<Publisher<M>>;
    explicit Publisher(std::string topic) : topic_(std::move(topic)) {}
    void publish(const M &message) { stub::world().published[topic_].push_back(message); }

private:
    std::string topic_;
};

template <typename M>
class Subscription {
public:
    using SharedPtr = std::shared_ptr<Subscription<M>>;
};

class Node {
public:
    explicit Node(const std::string &name, const NodeOptions &options = NodeOptions())
        : name_(name),
          parameters_(std::make_shared<node_interfaces::NodeParametersInterface>(
              options.parameter_overrides().empty() ? stub::world().arguments
                                                    : options.parameter_overrides())) {
        stub::world().declared.clear();
        stub::world().listeners.clear();
    }
    virtual ~Node() = default;

    Logger get_logger() const { return Logger(name_); }
    Clock::SharedPtr get_clock() { return std::make_shared<Clock>(RCL_ROS_TIME); }
    node_interfaces::NodeParametersInterface::SharedPtr get_node_parameters_interface() {
        return parameters_;
    }
    bool has_parameter(const std::string &name) const {
        return stub::world().declared.count(name) != 0;
    }

    template <typename T>
    T declare_parameter(const std::string &name, const T &default_value,
                        const rcl_interfaces::msg::ParameterDescriptor &descriptor =
                            rcl_interfaces::msg::ParameterDescriptor(),
                        bool ignore_override = false) {
        if (!stub::world().declared.emplace(name, descriptor).second) {
            throw exceptions::ParameterAlreadyDeclaredException(name + " is already declared");
        }
        T value = default_value;
        // Those of other names are dropped without a word.
        const auto &overrides = parameters_->get_parameter_overrides();
        const auto found = overrides.find(name);
        if (!ignore_override && found != overrides.end()) {
            const T *given = std::get_if<T>(&found->second.value());
            if (given == nullptr) {
                throw exceptions::InvalidParameterTypeException(name + " has another type");
            }
            value = *given;
        }
        if constexpr (std::is_same_v<T, double>) {
            for (const auto &range : descriptor.floating_point_range) {
                if (!(value >= range.from_value && value <= range.to_value)) {
                    throw exceptions::InvalidParameterValueException(name + " is out of its range");
                }
            }
        }
        if constexpr (std::is_same_v<T, std::int64_t>) {
            for (const auto &range : descriptor.integer_range) {
                if (!(value >= range.from_value && value <= range.to_value)) {
                    throw exceptions::InvalidParameterValueException(name + " is out of its range");
                }
            }
        }
        return value;
    }

    template <typename M>
    typename Publisher<M>::SharedPtr create_publisher(const std::string &topic, const QoS &) {
        return std::make_shared<Publisher<M>>(expanded(topic));
    }

    template <typename M, typename Callback>
    typename Subscription<M>::SharedPtr create_subscription(const std::string &topic, const QoS &,
                                                            Callback &&callback) {
        stub::world().listeners[expanded(topic)].push_back(
            [callback](const std::any &message) mutable {
                callback(std::make_shared<const M>(std::any_cast<M>(message)));
            });
        return std::make_shared<Subscription<M>>();
    }

private:
    std::string expanded(const std::string &topic) const {
        return topic.rfind("~/", 0) == 0 ? "/" + name_ + topic.substr(1) : topic;
    }

    std::string name_;
    node_interfaces::NodeParametersInterface::SharedPtr parameters_;
};

inline void init(int, const char *const *) {}
inline void spin(const std::shared_ptr<Node> &) {
    if (stub::world().spinning) stub::world().spinning();
}
inline bool shutdown() { return true; }

}  // namespace rclcpp

#define RCLCPP_INFO(logger, ...) rclcpp::stub::log("INFO", logger, __VA_ARGS__)
// As rcutils has it: each place that logs has its own time of the last one, which is 0 before, by the clock that it names.
#define RCLCPP_WARN_THROTTLE(logger, clock, duration_ms, ...)                                     \
    do {                                                                                          \
        static std::int64_t stub_last_ns = 0;                                                     \
        const std::int64_t stub_now_ns = (clock).now().nanoseconds();                             \
        if (stub_now_ns >= stub_last_ns + std::int64_t{duration_ms} * 1000000) {                  \
            stub_last_ns = stub_now_ns;                                                           \
            rclcpp::stub::log("WARN", logger, __VA_ARGS__);                                       \
        }                                                                                         \
    } while (false)
#define RCLCPP_FATAL(logger, ...) rclcpp::stub::log("FATAL", logger, __VA_ARGS__)
