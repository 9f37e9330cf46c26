/* port.c -- port.h on a PC: text on standard output; nothing is counted. */
#include "../port.h"

#include <stdio.h>
#include <stdlib.h>

void port_write(const char* text) { fputs(text, stdout); }

void port_exit(int status) { exit(status); }

void port_counter_start(void) {}

uint32_t port_counter(void) { return 0u; }

uint32_t port_instructions(uint32_t begin, uint32_t end) { return end - begin; }

void port_stack_paint(void) {}

uint32_t port_stack_used(void) { return 0u; }
