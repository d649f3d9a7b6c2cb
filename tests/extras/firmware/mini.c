/* A miniature with the outside of Betaflight's SITL: same ports, threads, packets and clock; motors = roll rate, RC. */
#include <arpa/inet.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static double state[18];
static struct { double time; uint16_t channels[16]; } rc;
static double (*law)(double, double);
static double total(double a, double b) { return 0.5 * a + b / 4000.0; }

static int server(int port) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port)};
    int fd = socket(AF_INET, SOCK_DGRAM, 0);
    if (bind(fd, (struct sockaddr *)&address, sizeof address)) exit(7);
    return fd;
}
static int links[2];
static void *receive(void *which) {
    int is_state = which == NULL, fd = links[(intptr_t)which];
    for (;;) {
        fd_set set;
        struct timeval wait = {0, 100000};
        struct sockaddr_in from;
        socklen_t size = sizeof from;
        FD_ZERO(&set);
        FD_SET(fd, &set);
        if (select(fd + 1, &set, NULL, NULL, &wait) != 1) continue;
        recvfrom(fd, is_state ? (void *)state : (void *)&rc, is_state ? sizeof state : sizeof rc, 0,
                 (struct sockaddr *)&from, &size);
    }
    return NULL;
}
int main(void) {
    pthread_t threads[2];
    struct timespec sleep = {0, 50000}, now;
    struct sockaddr_in motors_to = {.sin_family = AF_INET, .sin_port = htons(9002)};
    int fd = socket(AF_INET, SOCK_DGRAM, 0);
    law = total;
    for (intptr_t which = 0; which < 2; which++) links[which] = server(9003 + which);
    for (intptr_t which = 0; which < 2; which++) pthread_create(&threads[which], NULL, receive, (void *)which);
    for (;;) {
        float motors[4];
        clock_gettime(CLOCK_MONOTONIC, &now);
        for (int n = 0; n < 4; n++) motors[n] = law(state[1], rc.channels[n]);
        motors[3] = now.tv_nsec % 1000000 / 1e6;
        sendto(fd, motors, sizeof motors, 0, (struct sockaddr *)&motors_to, sizeof motors_to);
        if (rc.channels[15] == 1) *(volatile int *)NULL = 1;
        while (rc.channels[15] == 2) continue;
        if (rc.channels[15] == 3) exit(3);
        nanosleep(&sleep, NULL);
    }
}
