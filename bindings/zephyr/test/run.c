/* What Zephyr does for the sample: on this machine by its C library, on QEMU's boards by board.c. */
#include <stdarg.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#if __STDC_HOSTED__
#include <stdio.h>
#include <stdlib.h>

void printk(const char *format, ...) {
    va_list values;
    va_start(values, format);
    vprintf(format, values);
    va_end(values);
}

void k_panic(void) { abort(); }
#else
#include <board.h>

/* %s, %d and %u, and %08x. */
void printk(const char *format, ...) {
    va_list values;
    va_start(values, format);
    for (; *format; format++) {
        if (*format != '%') {
            print((const char[]){*format, 0});
            continue;
        }
        format++;
        if (*format == 's') {
            print(va_arg(values, const char *));
        } else if (*format == 'd' || *format == 'u') {
            print_number(va_arg(values, unsigned));
        } else if (format[0] == '0' && format[1] == '8' && format[2] == 'x') {
            print_hex(va_arg(values, unsigned), 8);
            format += 2;
        } else {
            print("printk knows no such conversion\n");
            board_exit(5);
        }
    }
    va_end(values);
}

void k_panic(void) {
    print("panic\n");
    board_exit(4);
}
#endif
