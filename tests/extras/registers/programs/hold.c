/* Keeps known values in rbx and in a vector register, and prints the value that has changed. */
#include <stdio.h>
#include <stdint.h>

int main(void)
{
    puts("ready");
    fflush(stdout);
    uint64_t found[4] = {0};
#ifdef VECTOR
    static const uint64_t held[4] __attribute__((aligned(32))) = {
        0x1111111111111111, 0x2222222222222222, 0x4444444444444444, 0x8888888888888888};
    __asm__ volatile(
        "vmovdqa (%0), %%ymm5\n"
        "1: vxorps (%0), %%ymm5, %%ymm6\n"
        "vptest %%ymm6, %%ymm6\n"
        "jz 1b\n"
        "vmovdqu %%ymm6, (%1)\n"
        : : "r"(held), "r"(found) : "xmm5", "xmm6", "memory", "cc");
    /* a strike of ymm6 is written over in the next round, unless it is tested: then it is what is found */
#else
    __asm__ volatile(
        "mov $0x0123456789abcdef, %%rbx\n"
        "mov %%rbx, %%r12\n"
        "1: cmp %%rbx, %%r12\n"
        "je 1b\n"
        "xor %%rbx, %%r12\n"
        "mov %%r12, (%0)\n"
        : : "r"(found) : "rbx", "r12", "memory", "cc");
#endif
    printf("%016lx%016lx%016lx%016lx\n", found[3], found[2], found[1], found[0]);
    return 0;
}
