/* Faults in the messages of a ROS 2 process, at the boundary from rcl to rmw: any language, any RMW, nothing remapped.
 *
 *   cc -O2 -shared -fPIC -Wl,-Bsymbolic -o libmavfi-interposer.so interposer.c
 *
 * Preloaded (LD_PRELOAD, and the page's path in MAVFI_ROS2_PAGE), the functions below replace those of rmw.  Loaded into
 * a running process, mavfi calls `mavfi_attach`, which redirects the calls of its libraries instead (their GOT), and
 * `mavfi_detach` at the end.  Idle, a call costs one load more.
 *
 * A sent message is never changed in place, as other readers may share it: what is sent is a copy of the message itself
 * and of the lists on the way to the number; all else is shared with the original.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <pthread.h>
#include <sys/mman.h>

#include "control.h"
#include "introspection.h"

/* The first members of rmw_publisher_t, rmw_subscription_t, rmw_client_t and rmw_service_t. */
typedef struct {
  const char *implementation;
  void *data;
  const char *name;
} entity_t;

/* rcutils_uint8_array_t with its allocator: a serialized message. */
typedef struct {
  uint8_t *buffer;
  size_t length, capacity;
  void *(*allocate)(size_t, void *);
  void (*deallocate)(void *, void *);
  void *(*reallocate)(void *, size_t, void *);
  void *(*zero_allocate)(size_t, size_t, void *);
  void *state;
} bytes_t;

/* rmw_message_sequence_t. */
typedef struct {
  void **data;
  size_t size, capacity;
  void *allocator;
} sequence_t;

static bool is_preloaded;
static bool is_late;  // loaded into a running process: the type support was handed over before

/* ---- the functions that rcl would have called -------------------------------------------------------------------- */
static void *next_function(const char *name) {
  // librcl's scope has them even where Python has loaded it with RTLD_LOCAL; this library is not in it.
  void *rcl = dlopen("librcl.so", RTLD_LAZY | RTLD_NOLOAD);
  void *function = rcl ? dlsym(rcl, name) : NULL;
  if (!function && !is_late) function = dlsym(RTLD_NEXT, name);
  return function;
}
#define NEXT(name)                                  \
  static __typeof__(&name) next;                    \
  if (!next) next = (__typeof__(&name))next_function(#name)

int rmw_publish(const entity_t *, const void *, void *);
int rmw_publish_serialized_message(const entity_t *, const bytes_t *, void *);
int rmw_serialize(const void *, const handle_t *, bytes_t *);
int rmw_deserialize(const bytes_t *, const handle_t *, void *);

static int serialize(const void *message, const handle_t *handle, bytes_t *bytes) {
  static __typeof__(&rmw_serialize) next;
  if (!next) next = (__typeof__(&rmw_serialize))next_function("rmw_serialize");
  return next(message, handle, bytes);
}
static int deserialize(const bytes_t *bytes, const handle_t *handle, void *message) {
  static __typeof__(&rmw_deserialize) next;
  if (!next) next = (__typeof__(&rmw_deserialize))next_function("rmw_deserialize");
  return next(bytes, handle, message);
}
static int publish_bytes(const entity_t *publisher, const bytes_t *bytes) {
  static __typeof__(&rmw_publish_serialized_message) next;
  if (!next) next = (__typeof__(&rmw_publish_serialized_message))next_function("rmw_publish_serialized_message");
  return next(publisher, bytes, NULL);
}

static void *allocate(size_t size, void *state) { return (void)state, malloc(size); }
static void deallocate(void *block, void *state) { (void)state, free(block); }
static void *reallocate(void *block, size_t size, void *state) { return (void)state, realloc(block, size); }
static void *zero_allocate(size_t count, size_t size, void *state) { return (void)state, calloc(count, size); }
static bytes_t no_bytes(void) {
  return (bytes_t){NULL, 0, 0, allocate, deallocate, reallocate, zero_allocate, NULL};
}

/* ---- publishers, subscriptions, clients and services, and their types -------------------------------------------- */
typedef struct {
  const void *entity;
  const handle_t *handle;
  type_t types[2];  // of a topic, twice the same; of a service, request and response
} known_t;
enum { MAX_KNOWN = 4096 };
static known_t known[MAX_KNOWN];
static pthread_mutex_t known_lock = PTHREAD_MUTEX_INITIALIZER;
static const void *const REMOVED = &known_lock;

/* The slot of an entity, or a free one; NULL: none.  With the lock held. */
static known_t *slot_of(const void *entity, bool is_new) {
  known_t *free_slot = NULL;
  size_t first = ((uintptr_t)entity >> 4) % MAX_KNOWN;
  for (size_t i = 0; i < MAX_KNOWN; i++) {
    known_t *slot = &known[(first + i) % MAX_KNOWN];
    if (slot->entity == entity) return slot;
    if (!free_slot && (!slot->entity || slot->entity == REMOVED)) free_slot = slot;
    if (!slot->entity) break;
  }
  return is_new ? free_slot : NULL;
}

static void set_types(known_t *slot, const void *data, bool is_service, bool is_cpp) {
  for (int part = 0; part < 2; part++) {
    const members_t *members = data;
    if (is_service) members = ((const members_t *const *)data)[2 + part];  // behind its namespace and name
    slot->types[part] = (type_t){members, is_cpp};
  }
}

static void remember(const void *entity, const handle_t *handle, bool is_service) {
  if (!entity || !handle || !control) return;
  // The handle answers for its own language; this loads the package's library of tables.
  bool is_cpp = strstr(handle->identifier, "_cpp") != NULL;
  const char *identifier = is_cpp ? "rosidl_typesupport_introspection_cpp" : "rosidl_typesupport_introspection_c";
  const handle_t *tables = handle->get(handle, identifier);
  if (!tables) {  // the failure must not show up as an error of the node's next call
    void (*reset)(void) = (void (*)(void))next_function("rcutils_reset_error");
    if (reset) reset();
    return;
  }
  pthread_mutex_lock(&known_lock);
  known_t *slot = slot_of(entity, true);
  if (slot) {
    slot->entity = entity;
    slot->handle = handle;
    set_types(slot, tables->data, is_service, is_cpp);
  }
  pthread_mutex_unlock(&known_lock);
}

static void forget(const void *entity) {
  pthread_mutex_lock(&known_lock);
  known_t *slot = slot_of(entity, false);
  if (slot) slot->entity = REMOVED;
  pthread_mutex_unlock(&known_lock);
}

static int note_rclpy(struct dl_phdr_info *library, size_t size, void *found) {
  (void)size;
  const char *name = strrchr(library->dlpi_name, '/');
  if (name && !strncmp(name, "/_rclpy", 7)) *(bool *)found = true;
  return 0;
}

static bool is_loaded(const char *package, const char *kind, const char *language) {
  char name[256];
  snprintf(name, sizeof name, "lib%s__%s_%s.so", package, kind, language);
  return dlopen(name, RTLD_LAZY | RTLD_NOLOAD) != NULL;
}

/* Looks up the tables of a type by its name: an entity that was made before this library was loaded.
 * False: the reason is in `why`. */
static bool remember_by_name(const entity_t *entity, const char *type_name, bool is_service, char *why) {
  char package[128], kind[16], name[128], library[300], symbol[512];
  if (sscanf(type_name, "%127[^/]/%15[^/]/%127s", package, kind, name) != 3) REFUSE("its type is not known");

  // Whether the process has C or C++ messages shows in the client library that it has loaded.  Tables for Python are no
  // sign of Python nodes: a C++ program that is linked without --as-needed loads them, too.
  bool has_cpp = is_loaded(package, "rosidl_typesupport", "cpp");
  bool has_rclcpp = dlopen("librclcpp.so", RTLD_LAZY | RTLD_NOLOAD) != NULL;
  bool has_rclpy = false;
  dl_iterate_phdr(note_rclpy, &has_rclpy);
  if (has_rclcpp && has_rclpy) REFUSE("C++ and Python nodes in one process: start it with `mavfi ros run`");
  bool is_cpp = has_rclcpp || (has_cpp && !has_rclpy);
  const char *language = is_cpp ? "cpp" : "c";

  // The package's library of tables, and its functions that return them and the handle for serialization.
  const char *of = is_service ? "service" : "message";
  snprintf(library, sizeof library, "lib%s__rosidl_typesupport_introspection_%s.so", package, language);
  snprintf(symbol, sizeof symbol, "rosidl_typesupport_introspection_%s__get_%s_type_support_handle__%s__%s__%s", language,
           of, package, kind, name);
  void *file = dlopen(library, RTLD_LAZY);
  const handle_t *(*tables)(void) = file ? (const handle_t *(*)(void))dlsym(file, symbol) : NULL;
  if (!tables) REFUSE("no tables of %.80s in this process's libraries", type_name);
  snprintf(library, sizeof library, "lib%s__rosidl_typesupport_%s.so", package, language);
  snprintf(symbol, sizeof symbol, "rosidl_typesupport_%s__get_%s_type_support_handle__%s__%s__%s", language, of, package,
           kind, name);
  file = dlopen(library, RTLD_LAZY);
  const handle_t *(*handle)(void) = file ? (const handle_t *(*)(void))dlsym(file, symbol) : NULL;
  pthread_mutex_lock(&known_lock);
  known_t *slot = slot_of(entity, true);
  if (slot) {
    slot->entity = entity;
    slot->handle = handle ? handle() : tables();
    set_types(slot, tables()->data, is_service, is_cpp);
  }
  pthread_mutex_unlock(&known_lock);
  return true;
}

/* The types of an entity. */
static bool types_of(const entity_t *entity, const fault_t *fault, known_t *copy, char *why) {
  bool is_service = fault->side > TAKE;
  for (int attempt = 0; attempt < 2; attempt++) {
    pthread_mutex_lock(&known_lock);
    known_t *slot = slot_of(entity, false);
    if (slot) *copy = *slot;
    pthread_mutex_unlock(&known_lock);
    if (slot) return true;
    if (!*fault->type) REFUSE("its type is not known");
    if (!remember_by_name(entity, fault->type, is_service, why)) return false;
  }
  REFUSE("too many topics");
}

/* ---- faults that are due ------------------------------------------------------------------------------------------ */
enum { VALUE_BYTES = 16 };
static struct {
  uint32_t generation;  // of the faults to which these belong
  bool has_value;
  uint8_t value[VALUE_BYTES];  // freeze of a number
  bytes_t message;             // freeze of a message; reorder: the message that waits
  const entity_t *publisher;   // reorder
  uint64_t wait;               // reorder: messages before it is sent
} held[MAX_FAULTS];
static _Atomic int waiting;  // messages that wait
static pthread_mutex_t held_lock = PTHREAD_MUTEX_INITIALIZER;

/* Reports why a message is not changed, for the first few. */
static void say(uint32_t index, uint64_t message, const char *why) {
  if (atomic_fetch_add(&control->faults[index].refused, 1) >= MAX_REFUSALS) return;
  report_t *report = begin_report(REFUSED, index, message);
  snprintf(report->text, TEXT, "%s", why);
  end_report(report);
}

/* A message that was due could not be changed: the fault waits for the next one. */
static void refuse(uint32_t index, uint64_t message, const char *why) {
  atomic_fetch_sub(&control->faults[index].changed, 1);
  say(index, message, why);
}

/* Changes a number as a fault says, and reports it. */
static void change_number(uint32_t index, uint64_t message, number_t *number) {
  fault_t *fault = &control->faults[index];
  uint8_t before[VALUE_BYTES] = {0};
  memcpy(before, number->at, number->width);
  double value = value_of(number);
  int bits = number->type == BOOLEAN ? 1 : 8 * number->width;
  if (number->type == LONG_DOUBLE) bits = 80;
  int bit = fault->bit;
  bool is_done = true;
  switch (fault->operation) {
    case FLIP:
      if (bit < 0) bit = (int)(hash(fault->seed, ~message) % (uint64_t)bits);
      if (bit >= bits) return refuse(index, message, "the number has no such bit");
      ((uint8_t *)number->at)[bit / 8] ^= (uint8_t)(1 << bit % 8);
      break;
    case SET: is_done = write_value(number, fault->value, false); break;
    case BIAS: is_done = write_value(number, value + fault->value, true); break;
    case SCALE: is_done = write_value(number, value * fault->value, true); break;
    default:  // freeze: at the value of the first message that is changed
      pthread_mutex_lock(&held_lock);
      if (!held[index].has_value) memcpy(held[index].value, before, VALUE_BYTES);
      held[index].has_value = true;
      memcpy(number->at, held[index].value, number->width);
      pthread_mutex_unlock(&held_lock);
  }
  if (!is_done) return refuse(index, message, "the number cannot hold this value");
  report_t *report = begin_report(CHANGED, index, message);
  report->type = number->type;
  report->width = number->width;
  report->bit = fault->operation == FLIP ? bit : -1;
  memcpy(report->before, before, VALUE_BYTES);
  memcpy(report->after, number->at, number->width);
  end_report(report);
}

/* What is to be done with a message. */
typedef struct {
  int fault;       // index of the fault in the whole message; -1: none
  uint64_t number; // of the message
  known_t known;   // type of the message
  void *copy;      // the changed message, NULL: none
  copies_t copies; // what it consists of
} verdict_t;

/* Forgets what earlier faults have held. */
static void renew_held(uint32_t generation) {
  static _Atomic uint32_t latest;
  if (atomic_exchange(&latest, generation) == generation) return;
  for (int i = 0; i < MAX_FAULTS; i++) {
    if (held[i].generation == generation) continue;
    pthread_mutex_lock(&held_lock);
    if (held[i].generation != generation && !held[i].wait) {
      free(held[i].message.buffer);
      memset(&held[i], 0, sizeof held[i]);
      held[i].generation = generation;
    }
    pthread_mutex_unlock(&held_lock);
  }
}

/* Whether the function that a call came from is a member of rclcpp's publisher of a ROS message.  With a type adapter, it
 * is one of a class of the user's own, and its object is not laid out as the message. */
static bool publishes(const void *caller, type_t type) {
  Dl_info function;
  if (!dladdr(caller, &function) || !function.dli_sname) return false;
  // The namespace is "package::msg"; the symbol begins with rclcpp::Publisher<package::msg::Name_<std::allocator<void>>.
  const char *namespace = type.members->space;
  int length = (int)strcspn(namespace, ":");
  char expected[512];
  snprintf(expected, sizeof expected, "_ZN6rclcpp9PublisherIN%d%.*s3msg%zu%s_ISaIvEE", length, length, namespace,
           strlen(type.members->name) + 1, type.members->name);
  return !strncmp(function.dli_sname, expected, strlen(expected));
}

/* Applies all faults in numbers of a message; the faults in the whole message are left to the caller.
 * `in_place`: the message is the receiver's own.
 * `announcer`: code of rclcpp that announced an object, which may be no ROS message; NULL: it is one. */
static verdict_t examine(int side, const entity_t *entity, int part, const void *message, bool in_place,
                         const void *announcer) {
  verdict_t verdict = {.fault = -1};
  uint32_t generation = atomic_load(&control->generation);
  uint32_t count = atomic_load(&control->armed);
  renew_held(generation);
  for (uint32_t i = 0; i < count && i < MAX_FAULTS; i++) {
    fault_t *fault = &control->faults[i];
    if (fault->side != side || strcmp(fault->topic, entity->name)) continue;
    if (fault->pid && fault->pid != process_id) continue;
    char why[TEXT] = "";
    number_t number;
    bool is_typed = types_of(entity, fault, &verdict.known, why);
    type_t type = verdict.known.types[part];
    if (is_typed && announcer && !publishes(announcer, type)) {
      is_typed = false;
      snprintf(why, TEXT, "handed over as a pointer to what may be no ROS message: link with -rdynamic, or as a component");
    }

    // Is it due?  The condition sees the message as it is.
    double condition = __builtin_nan("");
    bool is_absent = false;  // the number of the condition, which then never holds
    if (is_typed && fault->comparison != NO_CONDITION && !atomic_load(&fault->begun)) {
      is_absent = !find_number(type, (void *)message, fault->condition, NULL, &number, why);
      if (!is_absent) condition = value_of(&number);
    }
    uint64_t message_number;
    if (!due(fault, condition, &message_number)) {
      if (is_absent) say(i, message_number, why);
      continue;
    }
    if (atomic_load(&control->generation) != generation) break;  // armed again meanwhile
    if (!is_typed) {
      refuse(i, message_number, why);
      continue;
    }
    if (!*fault->field) {
      verdict.fault = (int)i;
      verdict.number = message_number;
      continue;
    }

    // Change the number, of a sent message in a copy.
    void *changed = (void *)message;
    if (!in_place) {
      if (!verdict.copy) verdict.copy = copy_block(&verdict.copies, message, type.members->size);
      changed = verdict.copy;
    }
    if (!changed || !find_number(type, changed, fault->field, in_place ? NULL : &verdict.copies, &number, why)) {
      refuse(i, message_number, why);
      continue;
    }
    change_number(i, message_number, &number);
  }
  return verdict;
}

static void report_whole(const verdict_t *verdict) { end_report(begin_report(CHANGED, (uint32_t)verdict->fault, verdict->number)); }

/* ---- publishing ---------------------------------------------------------------------------------------------------- */
typedef struct {
  const entity_t *publisher;
  bytes_t bytes;
  double seconds;
} late_message_t;

static void *publish_later(void *argument) {
  late_message_t *late = argument;
  struct timespec pause = {(time_t)late->seconds, (long)(1e9 * (late->seconds - (double)(time_t)late->seconds))};
  nanosleep(&pause, NULL);
  pthread_mutex_lock(&known_lock);  // so that the publisher is not destroyed meanwhile
  if (slot_of(late->publisher, false)) publish_bytes(late->publisher, &late->bytes);
  pthread_mutex_unlock(&known_lock);
  free(late->bytes.buffer);
  free(late);
  return NULL;
}

static bool delay(const entity_t *publisher, const void *message, const handle_t *handle, double seconds) {
  late_message_t *late = malloc(sizeof *late);
  if (!late) return false;
  *late = (late_message_t){publisher, no_bytes(), seconds};
  pthread_t thread;
  if (serialize(message, handle, &late->bytes) || pthread_create(&thread, NULL, publish_later, late)) {
    free(late->bytes.buffer);
    free(late);
    return false;
  }
  pthread_detach(thread);
  return true;
}

/* Keeps the message of `reorder` until others have passed; false: another one is waiting. */
static bool hold_back(int index, const entity_t *publisher, const void *message, const handle_t *handle, uint64_t wait) {
  pthread_mutex_lock(&held_lock);
  bool is_free = !held[index].wait;
  if (is_free) {
    held[index].message = no_bytes();
    is_free = !serialize(message, handle, &held[index].message);
    held[index].publisher = publisher;
    held[index].wait = is_free ? wait : 0;
    atomic_fetch_add(&waiting, is_free);
  }
  pthread_mutex_unlock(&held_lock);
  return is_free;
}

/* Another message of a publisher has been sent: sends those that have waited long enough. */
static void release_held(const entity_t *publisher) {
  if (!atomic_load(&waiting)) return;
  pthread_mutex_lock(&held_lock);
  for (int i = 0; i < MAX_FAULTS; i++) {
    if (held[i].publisher != publisher || !held[i].wait || --held[i].wait) continue;
    publish_bytes(publisher, &held[i].message);
    free(held[i].message.buffer);
    held[i].message = no_bytes();
    atomic_fetch_sub(&waiting, 1);
  }
  pthread_mutex_unlock(&held_lock);
}

/* Sends all messages that wait, before the calls are no longer seen. */
static void release_all(void) {
  pthread_mutex_lock(&held_lock);
  for (int i = 0; i < MAX_FAULTS; i++) {
    if (!held[i].wait) continue;
    held[i].wait = 0;
    publish_bytes(held[i].publisher, &held[i].message);
    atomic_fetch_sub(&waiting, 1);
  }
  pthread_mutex_unlock(&held_lock);
}

/* Publishes a message of which all numbers have been changed, as the fault in the whole message says. */
static int publish_as(const verdict_t *verdict, const entity_t *publisher, const void *message, void *allocation) {
  NEXT(rmw_publish);
  if (verdict->fault < 0) return next(publisher, message, allocation);
  int index = verdict->fault;
  const fault_t *fault = &control->faults[index];
  const handle_t *handle = verdict->known.handle;
  int result = 0;
  bool is_done = true;
  switch (fault->operation) {
    case DROP: break;
    case DELAY: is_done = delay(publisher, message, handle, fault->value); break;
    case REORDER: is_done = hold_back(index, publisher, message, handle, (uint64_t)fault->value); break;
    case DUPLICATE:
      for (int i = 0; i <= (int)fault->value && !result; i++) result = next(publisher, message, allocation);
      break;
    case FREEZE:
      pthread_mutex_lock(&held_lock);
      if (!held[index].message.buffer) {
        held[index].message = no_bytes();
        is_done = !serialize(message, handle, &held[index].message);
      }
      if (is_done) result = publish_bytes(publisher, &held[index].message);
      pthread_mutex_unlock(&held_lock);
      break;
    default: is_done = false;
  }
  if (is_done) {
    report_whole(verdict);
    return result;
  }
  refuse((uint32_t)index, verdict->number, "this message could not be treated so");
  return next(publisher, message, allocation);
}

// The publisher whose latest message has been examined when it was handed over within the process.  What it sends to
// other processes may be a copy, so the message is not known by its address.
static __thread const entity_t *announced_by;

int rmw_publish(const entity_t *publisher, const void *message, void *allocation) {
  NEXT(rmw_publish);
  bool is_examined = announced_by == publisher;
  announced_by = NULL;
  if (is_examined || (!is_armed() && !atomic_load(&waiting))) return next(publisher, message, allocation);
  if (!is_armed()) {
    int sent = next(publisher, message, allocation);
    release_held(publisher);
    return sent;
  }
  verdict_t verdict = examine(PUBLISH, publisher, 0, message, false, NULL);
  int result = publish_as(&verdict, publisher, verdict.copy ? verdict.copy : message, allocation);
  bool is_held = verdict.fault >= 0 && control->faults[verdict.fault].operation == REORDER;
  if (!is_held) release_held(publisher);
  free_copies(&verdict.copies);
  return result;
}

/* A message in serialized form, as a message of its type. */
typedef struct {
  known_t known;
  void *message;  // NULL: it could not be read
} parsed_t;

static parsed_t parse(int side, const entity_t *entity, const bytes_t *bytes) {
  parsed_t parsed = {.message = NULL};
  char why[TEXT];
  for (uint32_t i = 0; i < atomic_load(&control->armed) && i < MAX_FAULTS; i++) {
    fault_t *fault = &control->faults[i];
    if (fault->side != side || strcmp(fault->topic, entity->name)) continue;
    if (!types_of(entity, fault, &parsed.known, why)) continue;
    const members_t *members = parsed.known.types[0].members;
    parsed.message = calloc(1, members->size);
    if (!parsed.message) return parsed;
    initialize(members, parsed.message);
    if (!deserialize(bytes, parsed.known.handle, parsed.message)) return parsed;
    finalize(members, parsed.message);
    free(parsed.message);
    parsed.message = NULL;
  }
  return parsed;
}
static void free_parsed(parsed_t *parsed) {
  finalize(parsed->known.types[0].members, parsed->message);
  free(parsed->message);
}

int rmw_publish_serialized_message(const entity_t *publisher, const bytes_t *bytes, void *allocation) {
  NEXT(rmw_publish_serialized_message);
  if (!is_armed()) return next(publisher, bytes, allocation);
  parsed_t parsed = parse(PUBLISH, publisher, bytes);
  if (!parsed.message) return next(publisher, bytes, allocation);
  int result = rmw_publish(publisher, parsed.message, NULL);
  free_parsed(&parsed);
  return result;
}

int rmw_publish_loaned_message(const entity_t *publisher, void *message, void *allocation);
int rmw_publish_loaned_message(const entity_t *publisher, void *message, void *allocation) {
  NEXT(rmw_publish_loaned_message);
  if (is_armed()) {  // it belongs to the middleware from now on
    verdict_t verdict = examine(PUBLISH, publisher, 0, message, true, NULL);
    if (verdict.fault >= 0) refuse((uint32_t)verdict.fault, verdict.number, "a loaned message: only its numbers change");
  }
  return next(publisher, message, allocation);
}

/* rclcpp announces messages that it hands over within the process as pointers; they never reach rmw.  Since Iron. */
void ros_trace_rclcpp_intra_publish(const void *rcl_publisher, const void *message);
void ros_trace_rclcpp_intra_publish(const void *rcl_publisher, const void *message) {
  static void (*next)(const void *, const void *);
  static const entity_t *(*rmw_of)(const void *);
  if (!rmw_of) {
    next = (void (*)(const void *, const void *))next_function("ros_trace_rclcpp_intra_publish");
    rmw_of = (const entity_t *(*)(const void *))next_function("rcl_publisher_get_rmw_handle");
  }
  const entity_t *publisher = is_armed() && rmw_of ? rmw_of(rcl_publisher) : NULL;
  if (publisher) {
    verdict_t verdict = examine(PUBLISH, publisher, 0, message, true, __builtin_return_address(0));
    if (verdict.fault >= 0) {
      refuse((uint32_t)verdict.fault, verdict.number, "handed over as a pointer: only its numbers change");
    }
    announced_by = publisher;
  }
  if (next) next(rcl_publisher, message);
}

/* ---- taking: the message is in the reader's own memory -------------------------------------------------------------- */
static void examine_taken(int side, const entity_t *entity, int part, void *message, bool *taken) {
  if (!*taken || !is_armed()) return;
  verdict_t verdict = examine(side, entity, part, message, true, NULL);
  if (verdict.fault < 0) return;
  int index = verdict.fault;
  bool is_done = true;
  switch (control->faults[index].operation) {
    case DROP: *taken = false; break;  // as if nothing had come
    case FREEZE:
      pthread_mutex_lock(&held_lock);
      if (held[index].message.buffer) {
        is_done = !deserialize(&held[index].message, verdict.known.handle, message);
      } else {
        held[index].message = no_bytes();
        is_done = !serialize(message, verdict.known.handle, &held[index].message);
      }
      pthread_mutex_unlock(&held_lock);
      break;
    default: is_done = false;
  }
  if (is_done) return report_whole(&verdict);
  refuse((uint32_t)index, verdict.number, "a message that has arrived cannot be treated so");
}

static void examine_taken_bytes(const entity_t *entity, bytes_t *bytes, bool *taken) {
  if (!*taken || !is_armed()) return;
  parsed_t parsed = parse(TAKE, entity, bytes);
  if (!parsed.message) return;
  examine_taken(TAKE, entity, 0, parsed.message, taken);
  serialize(parsed.message, parsed.known.handle, bytes);
  free_parsed(&parsed);
}

#define TAKE_FUNCTION(name, parameters, arguments, then) \
  int name parameters;                                   \
  int name parameters {                                  \
    NEXT(name);                                          \
    int result = next arguments;                         \
    if (!result) then;                                   \
    return result;                                       \
  }
TAKE_FUNCTION(rmw_take, (const entity_t *s, void *m, bool *taken, void *a), (s, m, taken, a),
              examine_taken(TAKE, s, 0, m, taken))
TAKE_FUNCTION(rmw_take_with_info, (const entity_t *s, void *m, bool *taken, void *i, void *a), (s, m, taken, i, a),
              examine_taken(TAKE, s, 0, m, taken))
TAKE_FUNCTION(rmw_take_loaned_message_with_info, (const entity_t *s, void **m, bool *taken, void *i, void *a),
              (s, m, taken, i, a), examine_taken(TAKE, s, 0, *m, taken))
TAKE_FUNCTION(rmw_take_serialized_message, (const entity_t *s, bytes_t *b, bool *taken, void *a), (s, b, taken, a),
              examine_taken_bytes(s, b, taken))
TAKE_FUNCTION(rmw_take_serialized_message_with_info, (const entity_t *s, bytes_t *b, bool *taken, void *i, void *a),
              (s, b, taken, i, a), examine_taken_bytes(s, b, taken))
TAKE_FUNCTION(rmw_take_request, (const entity_t *s, void *h, void *m, bool *taken), (s, h, m, taken),
              examine_taken(TAKE_REQUEST, s, 0, m, taken))
TAKE_FUNCTION(rmw_take_response, (const entity_t *s, void *h, void *m, bool *taken), (s, h, m, taken),
              examine_taken(TAKE_RESPONSE, s, 1, m, taken))

int rmw_take_sequence(const entity_t *, size_t, sequence_t *, void *, size_t *, void *);
int rmw_take_sequence(const entity_t *subscription, size_t count, sequence_t *messages, void *infos, size_t *taken,
                      void *allocation) {
  NEXT(rmw_take_sequence);
  int result = next(subscription, count, messages, infos, taken, allocation);
  for (size_t i = 0; !result && i < *taken; i++) {
    bool is_taken = true;  // one of several cannot be dropped: the others would move
    examine_taken(TAKE, subscription, 0, messages->data[i], &is_taken);
  }
  return result;
}

/* ---- services and actions ------------------------------------------------------------------------------------------ */
#define SEND_FUNCTION(name, side, part, parameters, original, changed, dropped)                                     \
  int name parameters;                                                                                              \
  int name parameters {                                                                                             \
    NEXT(name);                                                                                                     \
    if (!is_armed()) return next original;                                                                          \
    verdict_t verdict = examine(side, s, part, m, false, NULL);                                                           \
    const void *sent = verdict.copy ? verdict.copy : m;                                                             \
    bool is_dropped = verdict.fault >= 0 && control->faults[verdict.fault].operation == DROP;                       \
    if (verdict.fault >= 0 && !is_dropped) refuse((uint32_t)verdict.fault, verdict.number, "a call: only its numbers change, or drop"); \
    if (is_dropped) report_whole(&verdict);                                                                         \
    int result = 0;                                                                                                 \
    if (is_dropped) {                                                                                               \
      dropped;                                                                                                      \
    } else {                                                                                                        \
      result = next changed;                                                                                        \
    }                                                                                                               \
    free_copies(&verdict.copies);                                                                                   \
    return result;                                                                                                  \
  }
static _Atomic int64_t lost_requests = INT64_MAX;  // numbers of requests that were never sent: no answer has them
SEND_FUNCTION(rmw_send_request, SEND_REQUEST, 0, (const entity_t *s, const void *m, int64_t *n), (s, m, n), (s, sent, n),
              *n = atomic_fetch_sub(&lost_requests, 1))
SEND_FUNCTION(rmw_send_response, SEND_RESPONSE, 1, (const entity_t *s, void *h, void *m), (s, h, m), (s, h, (void *)sent),
              (void)h)

#define CREATE_FUNCTION(name, is_service, parameters, arguments) \
  void *name parameters;                                         \
  void *name parameters {                                        \
    NEXT(name);                                                  \
    void *entity = next arguments;                               \
    remember(entity, handle, is_service);                        \
    return entity;                                               \
  }
CREATE_FUNCTION(rmw_create_publisher, false, (void *n, const handle_t *handle, char *t, void *q, void *o),
                (n, handle, t, q, o))
CREATE_FUNCTION(rmw_create_subscription, false, (void *n, const handle_t *handle, char *t, void *q, void *o),
                (n, handle, t, q, o))
CREATE_FUNCTION(rmw_create_client, true, (void *n, const handle_t *handle, char *t, void *q), (n, handle, t, q))
CREATE_FUNCTION(rmw_create_service, true, (void *n, const handle_t *handle, char *t, void *q), (n, handle, t, q))

#define DESTROY_FUNCTION(name)             \
  int name(void *node, void *entity);      \
  int name(void *node, void *entity) {     \
    NEXT(name);                            \
    forget(entity);                        \
    return next(node, entity);             \
  }
DESTROY_FUNCTION(rmw_destroy_publisher)
DESTROY_FUNCTION(rmw_destroy_subscription)
DESTROY_FUNCTION(rmw_destroy_client)
DESTROY_FUNCTION(rmw_destroy_service)

/* ---- loading ------------------------------------------------------------------------------------------------------- */
static void note_process(void) { process_id = (uint32_t)getpid(); }

static bool is_attached;  // to a page

static bool open_page(const char *path) {
  int file = open(path, O_RDWR | O_CLOEXEC);
  if (file < 0) return false;
  control_t *page = mmap(NULL, sizeof *page, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  close(file);
  if (page == MAP_FAILED) return false;
  if (page->magic != MAGIC || page->layout != LAYOUT) return false;
  if (is_attached && page->owner != control->owner && owner_lives()) {
    page->busy_with = control->owner;  // the faults of another mavfi would end without a word
    munmap(page, sizeof *page);
    return false;
  }
  is_attached = true;
  if (owner_fd >= 0) close(owner_fd);
  owner_fd = (int)syscall(SYS_pidfd_open, page->owner, 0);
  if (owner_fd >= 0) fcntl(owner_fd, F_SETFD, FD_CLOEXEC);
  note_process();
  static bool is_registered;
  if (!is_registered) pthread_atfork(NULL, NULL, note_process);
  is_registered = true;
  control = page;
  uint32_t index = atomic_fetch_add(&page->processes, 1);
  if (index < MAX_PROCESSES) page->pids[index] = process_id;
  return true;
}

__attribute__((constructor)) static void preloaded(void) {
  const char *path = getenv("MAVFI_ROS2_PAGE");
  if (path) {
    is_preloaded = true;
    open_page(path);
  }
}

/* Sizes and offsets that mavfi compares with its own. */
size_t mavfi_layout(size_t which);
size_t mavfi_layout(size_t which) {
  const size_t values[] = {sizeof(control_t),           sizeof(fault_t),           sizeof(report_t),
                           offsetof(control_t, faults), offsetof(control_t, reports), offsetof(fault_t, topic),
                           offsetof(fault_t, seen),     offsetof(report_t, text)};
  return which < sizeof values / sizeof *values ? values[which] : 0;
}

/* Calls that are redirected in a process that runs already. */
#define HOOK(name) {#name, (void *)name}
static const struct {
  const char *name;
  void *function;
} HOOKS[] = {
    HOOK(rmw_publish), HOOK(rmw_publish_serialized_message), HOOK(rmw_publish_loaned_message), HOOK(rmw_take),
    HOOK(rmw_take_with_info), HOOK(rmw_take_loaned_message_with_info), HOOK(rmw_take_serialized_message),
    HOOK(rmw_take_serialized_message_with_info), HOOK(rmw_take_sequence), HOOK(rmw_take_request), HOOK(rmw_take_response),
    HOOK(rmw_send_request), HOOK(rmw_send_response), HOOK(rmw_create_publisher), HOOK(rmw_create_subscription),
    HOOK(rmw_create_client), HOOK(rmw_create_service), HOOK(rmw_destroy_publisher), HOOK(rmw_destroy_subscription),
    HOOK(rmw_destroy_client), HOOK(rmw_destroy_service), HOOK(ros_trace_rclcpp_intra_publish)};
enum { MAX_SLOTS = 512 };
static struct {
  void **slot, *original;
} redirected[MAX_SLOTS];
static int redirected_count;

/* Writes a slot of a table that the loader may have made read-only. */
static bool write_slot(void **slot, void *function) {
  long page_size = sysconf(_SC_PAGESIZE);
  void *page = (void *)((uintptr_t)slot & ~(uintptr_t)(page_size - 1));
  if (mprotect(page, (size_t)page_size, PROT_READ | PROT_WRITE)) return false;
  __atomic_store_n(slot, function, __ATOMIC_RELEASE);
  return true;
}

static void redirect(void **slot, void *function) {
  if (*slot == function || redirected_count == MAX_SLOTS) return;
  redirected[redirected_count].slot = slot;
  redirected[redirected_count].original = *slot;
  if (write_slot(slot, function)) redirected_count++;
}

static int redirect_library(struct dl_phdr_info *library, size_t size, void *unused) {
  (void)size, (void)unused;
  Dl_info self;
  dladdr((void *)redirect_library, &self);
  const char *name = strrchr(library->dlpi_name, '/');
  name = name ? name + 1 : library->dlpi_name;
  if ((void *)library->dlpi_addr == self.dli_fbase) return 0;
  if (!strncmp(name, "librmw_", 7)) return 0;  // what is called: it forwards to itself

  // Its dynamic section: symbols, texts, and the relocations of calls and of addresses.
  const ElfW(Dyn) *dynamic = NULL;
  for (int i = 0; i < library->dlpi_phnum; i++) {
    if (library->dlpi_phdr[i].p_type == PT_DYNAMIC) {
      dynamic = (const void *)(library->dlpi_addr + library->dlpi_phdr[i].p_vaddr);
    }
  }
  if (!dynamic) return 0;
  const ElfW(Sym) *symbols = NULL;
  const char *texts = NULL;
  const ElfW(Rela) *tables[2] = {NULL, NULL};
  size_t sizes[2] = {0, 0};
  for (; dynamic->d_tag != DT_NULL; dynamic++) {
    uintptr_t address = dynamic->d_un.d_ptr;
    if (address < library->dlpi_addr) address += library->dlpi_addr;  // the vDSO's are not relocated
    switch (dynamic->d_tag) {
      case DT_SYMTAB: symbols = (const void *)address; break;
      case DT_STRTAB: texts = (const void *)address; break;
      case DT_JMPREL: tables[0] = (const void *)address; break;
      case DT_PLTRELSZ: sizes[0] = dynamic->d_un.d_val; break;
      case DT_RELA: tables[1] = (const void *)address; break;
      case DT_RELASZ: sizes[1] = dynamic->d_un.d_val; break;
      default: break;
    }
  }
  if (!symbols || !texts) return 0;
  for (int k = 0; k < 2; k++) {
    for (size_t i = 0; tables[k] && i < sizes[k] / sizeof(ElfW(Rela)); i++) {
      uint32_t type = ELF64_R_TYPE(tables[k][i].r_info);
      if (type != R_X86_64_JUMP_SLOT && type != R_X86_64_GLOB_DAT) continue;
      const char *symbol = texts + symbols[ELF64_R_SYM(tables[k][i].r_info)].st_name;
      for (size_t h = 0; h < sizeof HOOKS / sizeof *HOOKS; h++) {
        if (!strcmp(symbol, HOOKS[h].name)) {
          redirect((void **)(library->dlpi_addr + tables[k][i].r_offset), HOOKS[h].function);
        }
      }
    }
  }
  return 0;
}

/* Redirects the calls of this process, and counts them on the page. */
void mavfi_attach(const char *page_path);
void mavfi_attach(const char *page_path) {
  if (!open_page(page_path)) return;
  if (!is_preloaded) {
    is_late = true;
    dl_iterate_phdr(redirect_library, NULL);
  }
  atomic_fetch_add(&control->redirected, (uint32_t)(is_preloaded ? 1 : redirected_count));
}

/* Undoes `mavfi_attach`; the library stays, since a thread may be inside it. */
void mavfi_detach(void);
void mavfi_detach(void) {
  if (atomic_load(&waiting)) release_all();
  is_attached = is_preloaded && control && owner_lives();
  while (redirected_count) {
    redirected_count--;
    write_slot(redirected[redirected_count].slot, redirected[redirected_count].original);
    atomic_fetch_sub(&control->redirected, 1);
  }
}
