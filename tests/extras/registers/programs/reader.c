/* Waits in a system call; says what it got, or the error. */
#include <errno.h>
#include <stdio.h>
#include <unistd.h>

int main(void)
{
    char text[8] = {0};
    puts("ready");
    fflush(stdout);
    ssize_t count = read(0, text, sizeof text - 1);
    printf("%zd %d %s", count, count < 0 ? errno : 0, text);
    return 0;
}
