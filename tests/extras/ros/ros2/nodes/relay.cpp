// A C++ node on rcl alone, as rclcpp is in no package index: takes a message of each type and publishes it.
//   relay [--announce | --adapt | --open LIBRARY ...]: with --announce, it announces messages to the tracer first, as rclcpp
//   does within a process; with --adapt, objects that are none, as with a type adapter; with --open, it loads libraries, as a program does that is linked without --as-needed.
#include <chrono>
#include <cstdio>
#include <cstring>
#include <dlfcn.h>
#include <string>
#include <vector>

#include <geometry_msgs/msg/twist.hpp>
#include <nav_msgs/msg/occupancy_grid.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rcl/rcl.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <sensor_msgs/msg/laser_scan.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_msgs/msg/string.hpp>
#include <test_msgs/msg/basic_types.hpp>
#include <trajectory_msgs/msg/joint_trajectory.hpp>

extern "C" void ros_trace_rclcpp_intra_publish(const void *, const void *);

// The wheels' libraries refer to these of Python, which a C++ program does not have; it never uses them.
extern "C" {
void *PyExc_RuntimeError;
void *_Py_TrueStruct;
}

// As rclcpp's publisher announces a message; its symbol tells of which class the object is.
namespace rclcpp {
template <class Message, class Allocator>
struct Publisher {
  __attribute__((noinline)) static void announce(rcl_publisher_t *publisher, const Message *message) {
    ros_trace_rclcpp_intra_publish(publisher, message);
    asm volatile("" ::: "memory");  // no tail call, whose return address would be that of the caller
  }
};
}  // namespace rclcpp

static rcl_node_t node;
static bool announces, adapts;

static void check(rcl_ret_t result, const char *what) {
  if (result == RCL_RET_OK) return;
  fprintf(stderr, "%s: %s\n", what, rcutils_get_error_string().str);
  exit(1);
}

struct Route {
  rcl_subscription_t in = rcl_get_zero_initialized_subscription();
  rcl_publisher_t out = rcl_get_zero_initialized_publisher();
  virtual void relay() = 0;
  virtual ~Route() = default;
};

template <class Message>
struct RouteOf : Route {
  explicit RouteOf(const std::string &name) {
    auto type = rosidl_typesupport_cpp::get_message_type_support_handle<Message>();
    auto reading = rcl_subscription_get_default_options();
    reading.qos.depth = 100;
    auto writing = rcl_publisher_get_default_options();
    writing.qos.depth = 100;
    check(rcl_subscription_init(&in, &node, type, ("/in/" + name).c_str(), &reading), "subscription");
    check(rcl_publisher_init(&out, &node, type, ("/out/" + name).c_str(), &writing), "publisher");
  }
  void relay() override {
    Message message;
    rmw_message_info_t info;
    while (rcl_take(&in, &message, &info, nullptr) == RCL_RET_OK) {
      if (announces) rclcpp::Publisher<Message, std::allocator<void>>::announce(&out, &message);
      int own[64] = {0};  // in place of a class of the user's own
      if (adapts) ros_trace_rclcpp_intra_publish(&out, own);
      for (int number : own) check(number ? RCL_RET_ERROR : RCL_RET_OK, "an object that is no message was changed");
      check(rcl_publish(&out, &message, nullptr), "publish");
    }
    rcutils_reset_error();
  }
};

int main(int argc, char **argv) {
  adapts = argc > 1 && !strcmp(argv[1], "--adapt");
  announces = argc > 1 && !strcmp(argv[1], "--announce");
  for (int i = 2; i < argc && !strcmp(argv[1], "--open"); i++) {
    if (dlopen(argv[i], RTLD_LAZY | RTLD_GLOBAL)) continue;
    fprintf(stderr, "%s\n", dlerror());
    return 1;
  }
  auto allocator = rcl_get_default_allocator();
  auto options = rcl_get_zero_initialized_init_options();
  auto context = rcl_get_zero_initialized_context();
  auto node_options = rcl_node_get_default_options();
  node = rcl_get_zero_initialized_node();
  check(rcl_init_options_init(&options, allocator), "options");
  check(rcl_init(0, nullptr, &options, &context), "init");
  check(rcl_node_init(&node, "relay", "", &context, &node_options), "node");
  std::vector<Route *> routes = {
      new RouteOf<std_msgs::msg::Float64MultiArray>("Float64MultiArray"),
      new RouteOf<std_msgs::msg::String>("String"),
      new RouteOf<sensor_msgs::msg::JointState>("JointState"),
      new RouteOf<sensor_msgs::msg::LaserScan>("LaserScan"),
      new RouteOf<sensor_msgs::msg::PointCloud2>("PointCloud2"),
      new RouteOf<sensor_msgs::msg::Imu>("Imu"),
      new RouteOf<nav_msgs::msg::Odometry>("Odometry"),
      new RouteOf<nav_msgs::msg::Path>("Path"),
      new RouteOf<nav_msgs::msg::OccupancyGrid>("OccupancyGrid"),
      new RouteOf<geometry_msgs::msg::Twist>("Twist"),
      new RouteOf<trajectory_msgs::msg::JointTrajectory>("JointTrajectory"),
      new RouteOf<test_msgs::msg::BasicTypes>("BasicTypes")};
  auto waiting = rcl_get_zero_initialized_wait_set();
  check(rcl_wait_set_init(&waiting, routes.size(), 0, 0, 0, 0, 0, &context, allocator), "wait set");
  for (;;) {
    check(rcl_wait_set_clear(&waiting), "clear");
    for (auto *route : routes) check(rcl_wait_set_add_subscription(&waiting, &route->in, nullptr), "add");
    if (rcl_wait(&waiting, 100000000) != RCL_RET_OK) rcutils_reset_error();
    for (auto *route : routes) route->relay();
  }
}
