/* port.h -- functions of the processor for a program without an operating system.
 *
 * They give text output, an exit status, a count of executed instructions and the depth of the stack.
 *
 * Ports: cortex_m (QEMU mps2-an386, mps2-an500), cortex_r5 (QEMU xlnx-zcu102, RPU core 0), host (the same program on a
 * PC, to compare results with; it counts nothing). No port has a heap or libc input and output. */
#ifndef LPVGUARD_PORT_H
#define LPVGUARD_PORT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Writes text that ends with a zero. */
void port_write(const char* text);

/* Ends the run. Bare-metal start-up calls it with the result of main. 98: the program used the heap; 99: processor fault. */
#ifdef __GNUC__
__attribute__((noreturn))
#endif
void port_exit(int status);

/* A stream of bytes from and to the host (bare metal only: QEMU's semihosting console). Receiving stops the processor until
 * all bytes have arrived. port_write uses the same stream. */
void port_console_receive(void* data, size_t bytes);
void port_console_send(const void* data, size_t bytes);

/* The command line, cut to size - 1 characters; empty without one (bare metal only). */
void port_command_line(char* text, size_t size);

/* Starts the counter. */
void port_counter_start(void);

/* Reads the counter, which counts up and wraps. */
uint32_t port_counter(void);

/* Number of executed instructions between two readings, exact to one. QEMU under -icount counts instructions, not cycles.
 * The number is at most 5 million on Cortex-M, whose counter has 24 bits. */
uint32_t port_instructions(uint32_t begin, uint32_t end);

/* Fills the free part of the stack with a pattern. */
void port_stack_paint(void);

/* Number of stack bytes below the caller of port_stack_paint that have been written since then. */
uint32_t port_stack_used(void);

#ifdef __cplusplus
}
#endif

#endif
