/* counter.c -- the cycle counter of the performance monitor. Under -icount shift=0, QEMU adds one per instruction. */
#include "../port.h"

void port_counter_start(void) {
    const uint32_t enable_and_reset = 5u, cycle_counter = 1u << 31;
    __asm__ volatile("mcr p15, 0, %0, c9, c12, 0" ::"r"(enable_and_reset));
    __asm__ volatile("mcr p15, 0, %0, c9, c12, 1" ::"r"(cycle_counter));
}

uint32_t port_counter(void) {
    uint32_t value;
    __asm__ volatile("isb\n\tmrc p15, 0, %0, c9, c13, 0" : "=r"(value) : : "memory");
    return value;
}

uint32_t port_instructions(uint32_t begin, uint32_t end) { return end - begin; }
