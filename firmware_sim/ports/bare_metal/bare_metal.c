/* bare_metal.c -- the part of port.h that Cortex-M and Cortex-R share: Arm semihosting, the stack's depth, no heap. */
#include "../port.h"

#include <stddef.h>

extern uint32_t __stack_limit; /* of the linker script: lowest word of the stack */

static const uint32_t paint = 0xA5C3F00Du;
static const uint32_t* painted_from; /* stack pointer when the stack was painted */

static void semihosting(uint32_t operation, const void* argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void* r1 __asm__("r1") = argument;
#if __ARM_ARCH_PROFILE == 'M'
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
#else
    __asm__ volatile("svc 0x123456" : "+r"(r0) : "r"(r1) : "memory");
#endif
}

void port_write(const char* text)
{
    const uint32_t sys_write0 = 0x04u;
    semihosting(sys_write0, text);
}

void port_exit(int status)
{
    const uint32_t sys_exit_extended = 0x20u, application_exit = 0x20026u;
    const uint32_t block[2] = {application_exit, (uint32_t)status};
    for (;;) {
        semihosting(sys_exit_extended, block);
    }
}

/* newlib's malloc would call this. */
void* _sbrk(ptrdiff_t increment);
void* _sbrk(ptrdiff_t increment)
{
    (void)increment;
    port_write("the heap was asked for\n");
    port_exit(98);
}

static const uint32_t* stack_pointer(void)
{
    const uint32_t* sp;
    __asm__ volatile("mov %0, sp" : "=r"(sp));
    return sp;
}

/* Not inlined, and volatile: the compiler must neither move the writes nor see that nobody reads them. */
__attribute__((noinline)) void port_stack_paint(void)
{
    volatile uint32_t* word = &__stack_limit;
    painted_from = stack_pointer();
    while (word < painted_from) {
        *word++ = paint;
    }
}

__attribute__((noinline)) uint32_t port_stack_used(void)
{
    const volatile uint32_t* word = &__stack_limit;
    while (word < painted_from && *word == paint) {
        ++word;
    }
    return (uint32_t)((uintptr_t)painted_from - (uintptr_t)word);
}
