/* Sends itself 400 queued signals while it computes, and counts how many its handler has seen. */
#include <signal.h>
#include <stdio.h>
#include <unistd.h>

volatile long seen;
static void on_signal(int number) { (void)number; seen++; }

int main(void)
{
    const long sent = 400;
    volatile double x = 1;
    union sigval nothing = {0};
    signal(SIGRTMIN, on_signal);
    puts("ready");
    fflush(stdout);
    for (long i = 0; i < sent; i++) {
        while (sigqueue(getpid(), SIGRTMIN, nothing) != 0)
            ;
        for (int k = 0; k < 1000000; k++)
            x = x * 1.0000001 + 1e-9;
    }
    printf("%ld\n", sent - seen);
    return 0;
}
