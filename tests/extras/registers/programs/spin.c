/* Computes for ever; `work` is called again and again, `never` only after SIGUSR2. */
#include <signal.h>
#include <stdio.h>

volatile double result;
volatile sig_atomic_t wanted;

static void on_signal(int number) { (void)number; wanted = 1; }

__attribute__((noinline)) double work(double x, long n)
{
    for (long i = 0; i < n; i++) {
        x = x * 1.0000001 + 1e-9;
        if (x > 1e6)
            x = x / 3 - (double)(i & 7);
    }
    return x;
}

__attribute__((noinline)) void never(void) { result = -1; }

int main(void)
{
    double x = 1;
    signal(SIGUSR2, on_signal);
    puts("ready");
    fflush(stdout);
    for (;;) {
        x = work(x, 1000);
        result = x;
        if (wanted) {
            never();
            puts("never");
            fflush(stdout);
            wanted = 0;
        }
    }
}
