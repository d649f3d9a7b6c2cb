/* One thread waits, another computes; a third is made again and again, and calls `brief`. */
#include <pthread.h>
#include <stdio.h>
#include <sys/syscall.h>
#include <unistd.h>

volatile double result;

__attribute__((noinline)) void brief(void) { result = 2; }
static void *once(void *unused) { brief(); return unused; }

static void *compute(void *unused)
{
    printf("%ld\n", (long)syscall(SYS_gettid));
    fflush(stdout);
    for (double x = 1;; x = x * 1.0000001 + 1e-9)
        result = x;
    return unused;
}

int main(void)
{
    pthread_t worker, short_lived;
    pthread_create(&worker, 0, compute, 0);
    for (;;) {
        usleep(20000);
        pthread_create(&short_lived, 0, once, 0);
        pthread_join(short_lived, 0);
    }
}
