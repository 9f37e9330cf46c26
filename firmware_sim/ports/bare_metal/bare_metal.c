/* bare_metal.c -- common part of port.h for Cortex-M and Cortex-R: Arm semihosting, depth of the stack, no heap. */
#include "../port.h"

#include <stddef.h>

extern uint32_t __stack_limit; /* from the linker script: lowest word of the stack */

static const uint32_t paint = 0xA5C3F00Du;
static const uint32_t* painted_from; /* stack pointer when the stack was painted */

static uint32_t semihosting(uint32_t operation, const void* argument) {
    register uint32_t r0 __asm__("r0") = operation;
    register const void* r1 __asm__("r1") = argument;
#if __ARM_ARCH_PROFILE == 'M'
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
#else
    __asm__ volatile("svc 0x123456" : "+r"(r0) : "r"(r1) : "memory");
#endif
    return r0;
}

void port_write(const char* text) {
    const uint32_t sys_write0 = 0x04u;
    (void)semihosting(sys_write0, text);
}

void port_exit(int status) {
    const uint32_t sys_exit_extended = 0x20u, application_exit = 0x20026u;
    const uint32_t block[2] = {application_exit, (uint32_t)status};
    for (;;) {
        (void)semihosting(sys_exit_extended, block);
    }
}

/* SYS_READC: QEMU writes the character below the stack. Until 8.0 it returns the previous one, so this code reads the memory. */
static uint8_t console_character(void) {
    register uint32_t r0 __asm__("r0") = 0x07u;
#if __ARM_ARCH_PROFILE == 'M'
    __asm__ volatile("bkpt 0xab\n\tldrb r0, [sp, #-1]" : "+r"(r0) : : "memory");
#else
    __asm__ volatile("svc 0x123456\n\tldrb r0, [sp, #-1]" : "+r"(r0) : : "memory");
#endif
    return (uint8_t)r0;
}

void port_console_receive(void* data, size_t bytes) {
    uint8_t* to = (uint8_t*)data;
    while (bytes-- > 0u) {
        *to++ = console_character();
    }
}

void port_console_send(const void* data, size_t bytes) {
    const uint32_t sys_writec = 0x03u;
    const uint8_t* from = (const uint8_t*)data;
    while (bytes-- > 0u) {
        (void)semihosting(sys_writec, from++);
    }
}

void port_command_line(char* text, size_t size) {
    const uint32_t sys_get_cmdline = 0x15u;
    const uint32_t block[2] = {(uint32_t)(uintptr_t)text, size};
    text[0] = '\0';
    (void)semihosting(sys_get_cmdline, block);
}

/* newlib's malloc would call this. */
void* _sbrk(ptrdiff_t increment);
void* _sbrk(ptrdiff_t increment) {
    (void)increment;
    port_write("the heap was asked for\n");
    port_exit(98);
}

static const uint32_t* stack_pointer(void) {
    const uint32_t* sp;
    __asm__ volatile("mov %0, sp" : "=r"(sp));
    return sp;
}

/* This is not inlined and uses volatile, so that the compiler neither moves nor removes the writes. */
__attribute__((noinline)) void port_stack_paint(void) {
    volatile uint32_t* word = &__stack_limit;
    painted_from = stack_pointer();
    while (word < painted_from) {
        *word++ = paint;
    }
}

__attribute__((noinline)) uint32_t port_stack_used(void) {
    const volatile uint32_t* word = &__stack_limit;
    while (word < painted_from && *word == paint) {
        ++word;
    }
    return (uint32_t)((uintptr_t)painted_from - (uintptr_t)word);
}
