/* startup.c -- reset of a Cortex-M on Arm's MPS2 boards: FPU on, data and bss, main; and the instruction counter. */
#include "../port.h"

#include <stdint.h>

extern uint32_t __stack_top, __data_load, __data_start, __data_end, __bss_start, __bss_end;

#define CPACR (*(volatile uint32_t*)0xE000ED88u)
#define SYST_CSR (*(volatile uint32_t*)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t*)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t*)0xE000E018u)

int main(void);
void reset(void);
void fault(void);

void reset(void) {
    uint32_t* to;
    const uint32_t* from = &__data_load;
    CPACR |= 0xFu << 20; /* coprocessors 10 and 11 */
    __asm__ volatile("dsb\n\tisb");
    for (to = &__data_start; to < &__data_end; ++to) {
        *to = *from++;
    }
    for (to = &__bss_start; to < &__bss_end; ++to) {
        *to = 0u;
    }
    port_exit(main());
}

void fault(void) {
    port_write("processor fault\n");
    port_exit(99);
}

__attribute__((section(".vectors"), used)) static const void* const vectors[16] = {
    &__stack_top, (const void*)reset, (const void*)fault, (const void*)fault, (const void*)fault, (const void*)fault, (const void*)fault};

/* QEMU's processor models have no cycle counter. SysTick replaces it: 24 bits at 25 MHz, counting down. Under -icount shift=7,
 * an instruction takes 128 ns or 3.2 ticks. The count is exact to one instruction, up to 5.2 million instructions. */
void port_counter_start(void) {
    SYST_CSR = 0u;
    SYST_RVR = 0xFFFFFFu;
    SYST_CVR = 0u;
    SYST_CSR = 5u;
}

uint32_t port_counter(void) { return 0xFFFFFFu - SYST_CVR; }

uint32_t port_instructions(uint32_t begin, uint32_t end) { return (((end - begin) & 0xFFFFFFu) * 5u + 8u) / 16u; }
