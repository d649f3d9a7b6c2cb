/* The page that mavfi shares with the processes of a graph: faults, their progress, and reports of what was done.
 *
 * mavfi writes faults and arms them; the processes count messages and write reports.  All is lock-free: a process may be
 * killed at any instant.  `page.py` has the same layout; `mavfi_layout` lets it check that.
 */
#pragma once
#include <poll.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { MAX_REFUSALS = 3 };  // reports of refusals for each fault
enum { MAX_FAULTS = 16, MAX_REPORTS = 4096, MAX_PROCESSES = 256, TEXT = 160 };
enum { MAGIC = 0x4d415649, LAYOUT = 1 };

enum side { PUBLISH, TAKE, SEND_REQUEST, TAKE_REQUEST, SEND_RESPONSE, TAKE_RESPONSE };
enum operation { FLIP, SET, BIAS, SCALE, FREEZE, DROP, DELAY, DUPLICATE, REORDER };
enum comparison { NO_CONDITION, GREATER_EQUAL, LESS_EQUAL, GREATER, LESS, EQUAL };
enum report_kind { CHANGED, REFUSED, LOADED, UNLOADED };

typedef struct {
  // What and when: see mavfi.faults.changes.
  uint8_t side, operation, comparison, sim_time;
  int32_t bit;        // -1: drawn from the seed and the number of the message
  uint32_t pid;       // only in this process; 0: in any
  uint32_t reserved;
  double value, start_s, end_s, share, threshold;
  uint64_t first, times, every, seed;
  char topic[256], field[256], condition[256], type[128];
  // Progress, by all processes together.
  _Atomic uint64_t seen;     // messages of the topic
  _Atomic uint64_t begun;    // number of the first message that could be changed; 0: it has not come
  _Atomic uint64_t changed;  // changed messages
  _Atomic uint64_t refused;  // messages that were due but could not be changed
} fault_t;

typedef struct {
  _Atomic uint64_t ready;  // 1: complete; mavfi clears it when it has read the report
  uint32_t pid, fault;
  uint64_t message;
  int64_t wall_ns, sim_ns;
  uint8_t kind, type, width, reserved;
  int32_t bit;
  uint8_t before[16], after[16];
  char text[TEXT];
} report_t;

typedef struct {
  uint32_t magic, layout, owner;
  _Atomic uint32_t generation;  // grows when faults are armed
  _Atomic uint32_t armed;       // number of faults; 0: nothing is changed
  _Atomic uint32_t processes;   // that have loaded this library
  _Atomic uint32_t redirected;  // calls that `mavfi_attach` has redirected, minus those restored
  uint32_t busy_with;           // mavfi whose faults a process has already; 0: none
  int64_t armed_ns;             // CLOCK_MONOTONIC
  _Atomic int64_t sim_ns;       // the graph's simulated time
  _Atomic uint64_t reports_made;
  uint32_t pids[MAX_PROCESSES];
  fault_t faults[MAX_FAULTS];
  report_t reports[MAX_REPORTS];
} control_t;

static control_t *control;
static uint32_t process_id;  // of this process; a fork renews it
static int owner_fd = -1;  // becomes readable when mavfi ends; -1: not available

static inline int64_t now_ns(clockid_t clock) {
  struct timespec now;
  clock_gettime(clock, &now);
  return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

/* Whether mavfi is still there: without it nothing is changed. */
static inline bool owner_lives(void) {
  if (owner_fd < 0) return kill((pid_t)control->owner, 0) == 0;
  struct pollfd watch = {owner_fd, POLLIN, 0};
  return poll(&watch, 1, 0) == 0;
}

static inline bool is_armed(void) {
  return control && atomic_load_explicit(&control->armed, memory_order_acquire) != 0;
}

static report_t *begin_report(int kind, uint32_t fault, uint64_t message) {
  uint64_t number = atomic_fetch_add(&control->reports_made, 1);
  report_t *report = &control->reports[number % MAX_REPORTS];
  atomic_store(&report->ready, 0);
  memset((char *)report + sizeof report->ready, 0, sizeof *report - sizeof report->ready);
  report->kind = (uint8_t)kind;
  report->pid = process_id;
  report->fault = fault;
  report->message = message;
  report->bit = -1;
  report->wall_ns = now_ns(CLOCK_REALTIME);
  report->sim_ns = atomic_load(&control->sim_ns);
  return report;
}

static void end_report(report_t *report) { atomic_store_explicit(&report->ready, 1, memory_order_release); }

/* splitmix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, OOPSLA 2014). */
static inline uint64_t hash(uint64_t seed, uint64_t message) {
  uint64_t word = seed + message * UINT64_C(0x9E3779B97F4A7C15);
  word = (word ^ (word >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
  word = (word ^ (word >> 27)) * UINT64_C(0x94D049BB133111EB);
  return word ^ (word >> 31);
}

static inline bool holds(int comparison, double value, double threshold) {
  switch (comparison) {
    case GREATER_EQUAL: return value >= threshold;
    case LESS_EQUAL: return value <= threshold;
    case GREATER: return value > threshold;
    case LESS: return value < threshold;
    default: return value == threshold;
  }
}

/* Time on the fault's clock: simulated, or since it was armed (s). */
static inline double fault_time(const fault_t *fault) {
  if (fault->sim_time) return 1e-9 * (double)atomic_load(&control->sim_ns);
  return 1e-9 * (double)(now_ns(CLOCK_MONOTONIC) - control->armed_ns);
}

/* Counts a message; whether it is changed.  The twin of `MessageSchedule.due` in mavfi.faults.changes.
 * `condition`: value of the condition's field; NaN if the message lacks it, or without a condition. */
static bool due(fault_t *fault, double condition, uint64_t *number) {
  uint64_t message = atomic_fetch_add(&fault->seen, 1) + 1;
  *number = message;
  if (fault->times && atomic_load(&fault->changed) >= fault->times) return false;
  double time_s = fault_time(fault);
  if (time_s > fault->end_s) return false;

  // The fault begins with the first message that satisfies its trigger.
  uint64_t begun = atomic_load(&fault->begun);
  if (!begun) {
    if (message < fault->first || time_s < fault->start_s) return false;
    if (fault->comparison != NO_CONDITION && !holds(fault->comparison, condition, fault->threshold)) return false;
    atomic_compare_exchange_strong(&fault->begun, &begun, message);
    begun = atomic_load(&fault->begun);
  }

  // From then on every n-th, with a probability, and not more often than `times`.
  if (message < begun || (message - begun) % fault->every != 0) return false;
  double draw = (double)(hash(fault->seed, message) >> 11) / 9007199254740992.0;  // 2^53
  if (fault->share < 1.0 && draw >= fault->share) return false;
  if (!owner_lives()) {
    atomic_store(&control->armed, 0);
    return false;
  }
  uint64_t changed = atomic_load(&fault->changed);
  do {
    if (fault->times && changed >= fault->times) return false;
  } while (!atomic_compare_exchange_weak(&fault->changed, &changed, changed + 1));
  return true;
}
