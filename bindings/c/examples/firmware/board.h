/* What the example asks of its board: an emulated one, that prints through the debugger. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Prints a text. */
void print(const char *text);
/* Prints a number, in decimal. */
void print_number(uint64_t number);
/* Prints a number, in hexadecimal with so many digits. */
void print_hex(uint64_t number, int digits);
/* Ends the emulator. */
void board_exit(int code) __attribute__((noreturn));

/* Instructions since the last call; the emulator must run with -icount shift=0. */
uint32_t instructions(void);
/* The most stack that was ever in use, bytes. */
uint32_t stack_high_water(void);

#endif
