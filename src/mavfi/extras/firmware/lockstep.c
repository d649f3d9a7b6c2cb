/* Runs an unmodified Betaflight SITL binary in lock-step with a simulator, as an LD_PRELOAD library.
 *
 * Time is virtual.  Only the main thread moves it: each call of clock_gettime costs NS_PER_CALL, nanosleep its argument.
 * At the instant that the simulator has named, the main thread sends the motor commands and waits for the next sensor and
 * RC packets.  It does so inside nanosleep, where the firmware holds no lock; the firmware's two receiving threads run
 * while it waits, one after the other, so that the order of all events is fixed.
 *
 * No port is opened: bind and listen of the firmware have no effect.  Its serial port for configuration (MSP) is replaced
 * by a listening UNIX socket, if one is given.  Environment: LOCKSTEP_CHANNEL and LOCKSTEP_MSP, file descriptors.
 *
 * On request, the main thread stops for an injector, before the n-th instruction after its m-th call of this file in a
 * period, unless the next call comes first.  It counts by the processor's trap flag, in its own signal handler: no
 * debugger, no change of process for each instruction.  Instructions of this file, and of what it calls, do not count;
 * x86-64 Linux.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <link.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

#define NS_PER_CALL 50
#define NS 1000000000ull
#define TRAP_FLAG 0x100
#define NEXT(name) static __typeof__(&name) next; if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

enum { STATE, RC, LINKS };
enum { PORT_MOTORS = 9002, PORT_STATE = 9003, PORT_RC = 9004, PORT_MSP = 5761 };
enum { PERIOD_OVER, ARRIVED };

struct to_firmware { uint64_t next_ns, stop_call, stop_at, has_rc; uint8_t state[144], rc[40]; };
struct from_firmware { uint64_t now_ns, calls, instructions, address; uint32_t what, updates; float motors[4]; };

static struct to_firmware packet = {.stop_call = UINT64_MAX};
static struct from_firmware report;
static uint64_t now_ns = NS, next_ns = NS, calls, executed;
static volatile int leaving;
static uintptr_t own_first, own_last;
static pthread_t main_thread;
static int channel = -1, msp = -1, link_fd[LINKS] = {-1, -1};
static int waiting[LINKS], delivered[LINKS];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;

static int is_main(void) { return pthread_equal(pthread_self(), main_thread); }

static void report_to_simulator(int what, uint64_t address) {
    report.what = what;
    report.address = address;
    report.now_ns = now_ns;
    report.calls = calls;
    report.instructions = executed;
    if (write(channel, &report, sizeof report) != sizeof report) _exit(0);
}

/* ---- counting instructions --------------------------------------------------------------------------------------- */
/* Called before each instruction of the main thread while its trap flag is set. */
static void on_trap(int number, siginfo_t *info, void *context) {
    (void)number, (void)info;
    greg_t *registers = ((ucontext_t *)context)->uc_mcontext.gregs;
    uint64_t address = registers[REG_RIP];
    int is_own = address >= own_first && address < own_last;
    if (leaving && is_own) return;
    leaving = 0;
    if (!is_own && executed < packet.stop_at) {
        executed++;
        return;
    }
    registers[REG_EFL] &= ~TRAP_FLAG;
    if (is_own) return; /* the next call */
    char answer;
    report_to_simulator(ARRIVED, address);
    if (read(channel, &answer, 1) != 1) _exit(0);
}

/* The end of each function that the main thread calls: after the requested one, it traps. */
static inline void leave(void) {
    if (calls++ != packet.stop_call) return;
    leaving = 1;
    __asm__ volatile("pushf; orq %0, (%%rsp); popf" : : "i"(TRAP_FLAG) : "memory", "cc"); /* needs -mno-red-zone */
}

static int find_own_code(struct dl_phdr_info *info, size_t size, void *data) {
    (void)size, (void)data;
    for (int n = 0; n < info->dlpi_phnum; n++) {
        uintptr_t first = info->dlpi_addr + info->dlpi_phdr[n].p_vaddr, last = first + info->dlpi_phdr[n].p_memsz;
        if (!(info->dlpi_phdr[n].p_flags & PF_X) || (uintptr_t)on_trap < first || (uintptr_t)on_trap >= last) continue;
        own_first = first;
        own_last = last;
    }
    return 0;
}

/* ---- start, exchange ----------------------------------------------------------------------------------------------- */
static int number_in(const char *variable) {
    const char *text = getenv(variable);
    return text ? atoi(text) : -1;
}

__attribute__((constructor)) static void begin(void) {
    static char stack[65536];
    stack_t handler_stack = {.ss_sp = stack, .ss_size = sizeof stack};
    struct sigaction action = {.sa_sigaction = on_trap, .sa_flags = SA_SIGINFO | SA_ONSTACK};
    main_thread = pthread_self();
    channel = number_in("LOCKSTEP_CHANNEL");
    msp = number_in("LOCKSTEP_MSP");
    dl_iterate_phdr(find_own_code, NULL);
    sigaltstack(&handler_stack, NULL);
    sigaction(SIGTRAP, &action, NULL);
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* also ends a firmware that hangs when the simulator is killed */
}

/* Hands the packet to its thread, and returns when that thread asks for the next one. */
static void deliver(int which) {
    if (link_fd[which] < 0) return;
    pthread_mutex_lock(&lock);
    while (!waiting[which]) pthread_cond_wait(&changed, &lock);
    delivered[which] = 1;
    waiting[which] = 0;
    pthread_cond_broadcast(&changed);
    while (!waiting[which]) pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
}

static void exchange(void) {
    report_to_simulator(PERIOD_OVER, 0);
    if (read(channel, &packet, sizeof packet) != sizeof packet) _exit(0);
    report.updates = 0;
    calls = executed = 0;
    next_ns = packet.next_ns;
    deliver(STATE);
    if (packet.has_rc) deliver(RC);
}

/* ---- the firmware's clock ------------------------------------------------------------------------------------------ */
int clock_gettime(clockid_t clock, struct timespec *time) {
    (void)clock;
    if (is_main()) now_ns += NS_PER_CALL;
    time->tv_sec = now_ns / NS;
    time->tv_nsec = now_ns % NS;
    if (is_main()) leave();
    return 0;
}

int gettimeofday(struct timeval *restrict time, void *restrict zone) {
    (void)zone;
    time->tv_sec = now_ns / NS;
    time->tv_usec = now_ns / 1000 % 1000000;
    if (is_main()) leave();
    return 0;
}

int nanosleep(const struct timespec *duration, struct timespec *left) {
    if (!is_main()) {
        NEXT(nanosleep);
        return next(duration, left);
    }
    uint64_t end = now_ns + duration->tv_sec * NS + duration->tv_nsec;
    while (end >= next_ns) {
        if (next_ns > now_ns) now_ns = next_ns;
        exchange();
    }
    if (end > now_ns) now_ns = end;
    leave();
    return 0;
}

/* ---- the firmware's sockets ---------------------------------------------------------------------------------------- */
int bind(int fd, const struct sockaddr *address, socklen_t size) {
    (void)size;
    int port = ntohs(((const struct sockaddr_in *)address)->sin_port);
    if (port == PORT_STATE) link_fd[STATE] = fd;
    if (port == PORT_RC) link_fd[RC] = fd;
    if (port == PORT_MSP && msp >= 0) return dup2(msp, fd) < 0 ? -1 : 0;
    return 0;
}

int listen(int fd, int backlog) {
    (void)fd, (void)backlog;
    return 0;
}

int select(int count, fd_set *restrict reading, fd_set *restrict writing, fd_set *restrict errors,
           struct timeval *restrict timeout) {
    for (int which = 0; which < LINKS; which++) {
        if (link_fd[which] < 0 || !reading || !FD_ISSET(link_fd[which], reading)) continue;
        pthread_mutex_lock(&lock);
        waiting[which] = 1;
        pthread_cond_broadcast(&changed);
        while (!delivered[which]) pthread_cond_wait(&changed, &lock);
        delivered[which] = 0;
        pthread_mutex_unlock(&lock);
        return 1;
    }
    if (msp >= 0) {
        NEXT(select);
        return next(count, reading, writing, errors, timeout);
    }
    for (;;) pause(); /* the thread of the serial ports */
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *restrict address,
                 socklen_t *restrict address_size) {
    (void)flags, (void)address, (void)address_size;
    int is_state = fd == link_fd[STATE];
    size_t length = is_state ? sizeof packet.state : sizeof packet.rc;
    if (length > size) length = size;
    memcpy(data, is_state ? packet.state : packet.rc, length);
    return length;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t to_size) {
    (void)fd, (void)flags, (void)to_size;
    if (ntohs(((const struct sockaddr_in *)to)->sin_port) == PORT_MOTORS) {
        memcpy(report.motors, data, sizeof report.motors);
        report.updates++;
    }
    if (is_main()) leave();
    return size;
}
