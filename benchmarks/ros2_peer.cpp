// A C++ node on plain rcl, for timing.
//   peer publish COUNT SIZE    time of COUNT calls of rcl_publish with SIZE bytes (ns per call); waits for a reader
//   peer echo                  sends back what comes
//   peer ping COUNT            round trips of 8 doubles through `echo`: their median (us)
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include <rcl/rcl.h>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>

// The wheels' libraries refer to these of Python, which a C++ program does not have; it never uses them.
extern "C" {
void *PyExc_RuntimeError;
void *_Py_TrueStruct;
}

using Message = std_msgs::msg::Float64MultiArray;
using Clock = std::chrono::steady_clock;

static void check(rcl_ret_t result, const char *what) {
  if (result == RCL_RET_OK) return;
  fprintf(stderr, "%s: %s\n", what, rcutils_get_error_string().str);
  exit(1);
}

int main(int argc, char **argv) {
  auto allocator = rcl_get_default_allocator();
  auto options = rcl_get_zero_initialized_init_options();
  auto context = rcl_get_zero_initialized_context();
  auto node_options = rcl_node_get_default_options();
  auto node = rcl_get_zero_initialized_node();
  check(rcl_init_options_init(&options, allocator), "options");
  check(rcl_init(0, nullptr, &options, &context), "init");
  check(rcl_node_init(&node, argv[1], "", &context, &node_options), "node");
  auto type = rosidl_typesupport_cpp::get_message_type_support_handle<Message>();
  auto reading = rcl_subscription_get_default_options();
  auto writing = rcl_publisher_get_default_options();
  auto subscription = rcl_get_zero_initialized_subscription();
  auto publisher = rcl_get_zero_initialized_publisher();
  bool is_echo = !strcmp(argv[1], "echo");
  check(rcl_publisher_init(&publisher, &node, type, is_echo ? "/pong" : "/ping", &writing), "publisher");
  bool reads = strcmp(argv[1], "publish") != 0;
  if (reads) check(rcl_subscription_init(&subscription, &node, type, is_echo ? "/ping" : "/pong", &reading), "subscription");
  Message message;

  if (!reads) {
    size_t readers = 0;
    while (!readers) check(rcl_publisher_get_subscription_count(&publisher, &readers), "count");
    size_t count = strtoul(argv[2], nullptr, 10);
    message.data.assign(strtoul(argv[3], nullptr, 10) / 8, 1.0);
    std::vector<double> blocks;
    for (int block = 0; block < 20; block++) {
      auto begin = Clock::now();
      for (size_t i = 0; i < count / 20; i++) check(rcl_publish(&publisher, &message, nullptr), "publish");
      blocks.push_back(std::chrono::duration<double, std::nano>(Clock::now() - begin).count() / (count / 20));
    }
    std::sort(blocks.begin(), blocks.end());
    printf("%f\n", blocks[2]);  // of 20, undisturbed by others
    return 0;
  }

  auto waiting = rcl_get_zero_initialized_wait_set();
  check(rcl_wait_set_init(&waiting, 1, 0, 0, 0, 0, 0, &context, allocator), "wait set");
  auto take = [&] {
    rmw_message_info_t info;
    while (rcl_take(&subscription, &message, &info, nullptr) != RCL_RET_OK) {
      rcutils_reset_error();
      check(rcl_wait_set_clear(&waiting), "clear");
      check(rcl_wait_set_add_subscription(&waiting, &subscription, nullptr), "add");
      if (rcl_wait(&waiting, 100000000) != RCL_RET_OK) rcutils_reset_error();
    }
  };
  if (is_echo) {
    for (;;) {
      take();
      check(rcl_publish(&publisher, &message, nullptr), "publish");
    }
  }
  size_t peers = 0;
  while (!peers) check(rcl_publisher_get_subscription_count(&publisher, &peers), "count");
  peers = 0;
  while (!peers) check(rcl_subscription_get_publisher_count(&subscription, &peers), "count");
  size_t count = strtoul(argv[2], nullptr, 10);
  std::vector<double> times;
  message.data.assign(8, 1.0);
  for (size_t i = 0; i < count; i++) {
    auto begin = Clock::now();
    check(rcl_publish(&publisher, &message, nullptr), "publish");
    take();
    times.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begin).count());
  }
  std::nth_element(times.begin(), times.begin() + count / 2, times.end());
  printf("%f\n", times[count / 2]);
}
