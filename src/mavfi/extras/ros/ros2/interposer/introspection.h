/* Finds a number of a ROS 2 message in memory, by ROS's own introspection tables; no ROS header is needed.
 *
 * The tables of C and C++ messages have the same layout.  Jazzy added `is_key` to members and `has_any_key_member` to
 * messages; Humble and Iron lack both, which is recognised at run time.
 */
#pragma once
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* rosidl_message_type_support_t, and the beginning of rosidl_service_type_support_t. */
typedef struct handle_s handle_t;
struct handle_s {
  const char *identifier;
  const void *data;
  const handle_t *(*get)(const handle_t *, const char *);
};

/* MessageMember. */
typedef struct {
  const char *name;
  uint8_t type;
  size_t string_bound;
  const handle_t *members;
  uint8_t is_key_or_array;  // since Jazzy is_key; before, is_array
  uint8_t is_array;         // since Jazzy
  size_t array_size;
  uint8_t is_upper_bound;
  uint32_t offset;
  const void *default_value;
  void *functions[6];
} member_t;

/* MessageMembers. */
typedef struct {
  const char *space, *name;
  uint32_t count;
  size_t size;
  union {
    const member_t *members;  // before Jazzy
    uint8_t has_key;          // since Jazzy
  } word;
  const void *rest[3];  // since Jazzy members, init, fini; before, init, fini
} members_t;

enum { FLOAT = 1, DOUBLE, LONG_DOUBLE, CHAR, WCHAR, BOOLEAN, OCTET, UINT8, INT8, UINT16, INT16, UINT32, INT32, UINT64,
       INT64, STRING, WSTRING, MESSAGE };
static const uint8_t WIDTH[] = {0, 4, 8, 16, 1, 2, 1, 1, 1, 1, 2, 2, 4, 4, 8, 8};
enum { C_STRING = 24, CPP_STRING = 32 };  // sizes of rosidl_runtime_c__String and std::string

static inline bool is_before_jazzy(const members_t *type) { return (uintptr_t)type->word.members > 0xffff; }
static inline const member_t *members_of(const members_t *type) {
  return is_before_jazzy(type) ? type->word.members : type->rest[0];
}
static inline void initialize(const members_t *type, void *message) {
  void (*function)(void *, int) = is_before_jazzy(type) ? type->rest[0] : type->rest[1];
  function(message, 0);
}
static inline void finalize(const members_t *type, void *message) {
  void (*function)(void *) = is_before_jazzy(type) ? type->rest[1] : type->rest[2];
  function(message);
}

/* A type as its tables describe it, in the language of the process. */
typedef struct {
  const members_t *members;
  bool is_cpp;
} type_t;

/* A number in a message. */
typedef struct {
  void *at;
  uint8_t width, type;
} number_t;

/* The lists of a message that have been copied, so that the sender's own message stays as it is. */
enum { MAX_COPIES = 40 };
typedef struct {
  void *blocks[MAX_COPIES];
  int count;
} copies_t;

static void *copy_block(copies_t *copies, const void *block, size_t size) {
  if (copies->count == MAX_COPIES) return NULL;
  void *copy = malloc(size ? size : 1);
  if (!copy) return NULL;
  memcpy(copy, block, size);
  return copies->blocks[copies->count++] = copy;
}
static void free_copies(copies_t *copies) {
  while (copies->count) free(copies->blocks[--copies->count]);
}

#define REFUSE(...) return snprintf(why, TEXT, __VA_ARGS__), false

/* Finds the number at a path such as poses[2].pose.position.x, data[17] or name[0][3].
 * `copies`: lists on the way are replaced by copies, in `message` and below; NULL: the number in place.
 * False: there is none; the reason is in `why`. */
static bool find_number(type_t type, void *message, const char *path, copies_t *copies, number_t *number, char *why) {
  for (;;) {
    // The member with this name.
    size_t length = strcspn(path, ".[");
    const member_t *member = NULL;
    for (uint32_t i = 0; i < type.members->count; i++) {
      const member_t *candidate = members_of(type.members) + i;
      if (strlen(candidate->name) == length && !strncmp(candidate->name, path, length)) member = candidate;
    }
    bool is_empty = type.members->count == 0;
    // C has no empty structures
    if (type.members->count == 1) is_empty = !strcmp(members_of(type.members)->name, "structure_needs_at_least_one_member");
    if (is_empty) REFUSE("%s has no field; allowed: drop, delay, duplicate", type.members->name);
    if (!member) REFUSE("no member %.*s in %s", (int)length, path, type.members->name);
    path += length;
    char *at = (char *)message + member->offset;
    type_t inner = {NULL, type.is_cpp};
    size_t width = type.is_cpp ? CPP_STRING : C_STRING;
    if (member->type == MESSAGE) {
      inner.members = member->members->data;
      width = inner.members->size;
    } else if (member->type < STRING) {
      width = WIDTH[member->type];
    }

    // An element of a list: an array within the message, or a sequence elsewhere.
    bool is_array = is_before_jazzy(type.members) ? member->is_key_or_array : member->is_array;
    if (is_array) {
      if (*path != '[') REFUSE("%s is a list: name an element, e.g. %s[0]", member->name, member->name);
      size_t index = strtoul(path + 1, (char **)&path, 10);
      path++;
      size_t size = member->array_size;
      if (!size || member->is_upper_bound) {
        if (type.is_cpp && member->type == BOOLEAN) REFUSE("%s is a std::vector<bool>: out of reach", member->name);
        void **sequence = (void **)at;
        if (type.is_cpp) {
          size = (size_t)((char *)sequence[1] - (char *)sequence[0]) / width;
        } else {
          size = ((size_t *)at)[1];
        }
        if (index >= size) REFUSE("%s has %zu elements", member->name, size);
        if (copies) {
          char *copy = copy_block(copies, sequence[0], size * width);
          if (!copy) REFUSE("out of memory");
          sequence[0] = copy;
          if (type.is_cpp) sequence[1] = sequence[2] = copy + size * width;
        }
        at = sequence[0];
      }
      if (index >= size) REFUSE("%s has %zu elements", member->name, size);
      at += index * width;
    }

    // Further inside, or the end of the path.
    if (member->type == MESSAGE) {
      if (*path != '.') REFUSE("%s is a message: name a member of it", member->name);
      path++;
      message = at;
      type = inner;
      continue;
    }
    *number = (number_t){at, (uint8_t)width, member->type};
    if (member->type >= STRING) {
      if (*path != '[') REFUSE("%s is a text: name a character, e.g. %s[0]", member->name, member->name);
      size_t index = strtoul(path + 1, (char **)&path, 10);
      path++;
      size_t size = ((size_t *)at)[1];  // data and size come first in both languages
      size_t character = member->type == STRING ? 1 : 2;
      if (index >= size) REFUSE("%s has %zu characters", member->name, size);
      void **text = (void **)at;
      if (copies) {
        void *copy = copy_block(copies, text[0], (size + 1) * character);
        if (!copy) REFUSE("out of memory");
        text[0] = copy;
      }
      *number = (number_t){(char *)text[0] + index * character, (uint8_t)character, character == 1 ? UINT8 : UINT16};
    }
    if (*path) REFUSE("%s is a number: nothing is inside it", member->name);
    return true;
  }
}

static double value_of(const number_t *number) {
  switch (number->type) {
    case FLOAT: return *(float *)number->at;
    case DOUBLE: return *(double *)number->at;
    case LONG_DOUBLE: return (double)*(long double *)number->at;
    case INT8: return *(int8_t *)number->at;
    case INT16: return *(int16_t *)number->at;
    case INT32: return *(int32_t *)number->at;
    case INT64: return (double)*(int64_t *)number->at;
    case UINT16: case WCHAR: return *(uint16_t *)number->at;
    case UINT32: return *(uint32_t *)number->at;
    case UINT64: return (double)*(uint64_t *)number->at;
    default: return *(uint8_t *)number->at;
  }
}

/* Limits of an integer type; those of 64 bits as the nearest doubles. */
static void limits(int type, double *lower, double *upper) {
  int bits = 8 * WIDTH[type];
  bool is_signed = type == INT8 || type == INT16 || type == INT32 || type == INT64;
  *upper = 1.0;
  for (int i = is_signed; i < bits; i++) *upper *= 2.0;
  *lower = is_signed ? -*upper : 0.0;
  *upper -= 1.0;
  if (type == BOOLEAN) *upper = 1.0;
}

/* Writes a value; integers are rounded to the nearest and limited.  False: NaN, or out of the range of `set`. */
static bool write_value(number_t *number, double value, bool is_limited) {
  if (number->type == FLOAT) return *(float *)number->at = (float)value, true;
  if (number->type == DOUBLE) return *(double *)number->at = value, true;
  if (number->type == LONG_DOUBLE) return *(long double *)number->at = value, true;
  double lower, upper;
  limits(number->type, &lower, &upper);
  if (value != value || (!is_limited && (value < lower || value > upper || value != __builtin_rint(value)))) return false;
  value = __builtin_rint(value);
  uint64_t word;
  if (value >= upper) {
    word = upper >= 0x1p64 ? UINT64_MAX : upper >= 0x1p63 ? (uint64_t)INT64_MAX : (uint64_t)upper;
  } else if (value <= lower) {
    word = (uint64_t)(int64_t)lower;
  } else {
    word = value < 0 ? (uint64_t)(int64_t)value : (uint64_t)value;
  }
  memcpy(number->at, &word, number->width);
  return true;
}
