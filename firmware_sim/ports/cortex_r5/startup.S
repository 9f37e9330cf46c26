/* startup.S -- reset of a Cortex-R5F (ZynqMP RPU core 0): low vectors, FPU on, one stack, bss, main. QEMU loads .data. */
  .syntax unified
  .arm
  .section .vectors, "ax"
  .global _start
_start:
  ldr pc, =reset
  ldr pc, =fault
  b .                              /* supervisor call: semihosting takes it */
  ldr pc, =fault
  ldr pc, =fault
  b .
  b .
  b .
  .ltorg

  .text
reset:
  mrc p15, 0, r0, c1, c0, 0        /* SCTLR: vectors at 0, not at 0xFFFF0000 */
  bic r0, r0, #(1 << 13)
  mcr p15, 0, r0, c1, c0, 0
  mrc p15, 0, r0, c1, c0, 2        /* CPACR: coprocessors 10 and 11 */
  orr r0, r0, #(0xF << 20)
  mcr p15, 0, r0, c1, c0, 2
  isb
  mov r0, #0x40000000
  vmsr fpexc, r0
  ldr sp, =__stack_top
  ldr r0, =__bss_start
  ldr r1, =__bss_end
  mov r2, #0
1:
  cmp r0, r1
  strlo r2, [r0], #4
  blo 1b
  bl main
  bl port_exit

fault:
  ldr sp, =__stack_top
  ldr r0, =fault_text
  bl port_write
  mov r0, #99
  bl port_exit

  .section .rodata
fault_text:
  .asciz "processor fault\n"
