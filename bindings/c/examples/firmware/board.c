/* Start-up, vectors and semihosting for a Cortex-M with a floating point unit, without a C library. */
#include "board.h"

extern uint32_t data_load[], data_start[], data_end[], slow_load[], slow_start[], slow_end[];
extern uint32_t bss_start[], bss_end[];
extern uint32_t stack_bottom[], stack_top[];
int main(void);
void reset(void);
static void fault(void);

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)stack_top, (uintptr_t)reset, (uintptr_t)fault, (uintptr_t)fault,
    (uintptr_t)fault, (uintptr_t)fault, (uintptr_t)fault, (uintptr_t)fault,
    0, 0, 0, (uintptr_t)fault, (uintptr_t)fault, 0, (uintptr_t)fault, (uintptr_t)fault,
};

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define CPACR REGISTER(0xe000ed88)
#define SYST_CSR REGISTER(0xe000e010)
#define SYST_RVR REGISTER(0xe000e014)
#define SYST_CVR REGISTER(0xe000e018)
#define PAINT 0x5a5a5a5au

void reset(void) {
    CPACR |= 0xfu << 20; /* the floating point unit, before any function that saves its registers */
    __asm__ volatile("dsb\n isb" ::: "memory");
    for (uint32_t *to = data_start, *from = data_load; to < data_end;) *to++ = *from++;
    for (uint32_t *to = slow_start, *from = slow_load; to < slow_end;) *to++ = *from++;
    for (uint32_t *to = bss_start; to < bss_end;) *to++ = 0;
    uint32_t *here;
    __asm__ volatile("mov %0, sp" : "=r"(here));
    for (volatile uint32_t *to = stack_bottom; to < here - 16;) *to++ = PAINT;
    SYST_RVR = 0xffffff;
    SYST_CVR = 0;
    SYST_CSR = 5; /* on, processor clock, no interrupt */
    board_exit(main());
}

/* The debugger's services: the number in r0, the argument in r1. */
static uint32_t semihosting(uint32_t service, const void *argument) {
    register uint32_t r0 __asm__("r0") = service;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void print(const char *text) { semihosting(0x04, text); }

void print_number(uint64_t number) {
    char text[21];
    int at = 20;
    text[at] = 0;
    do {
        text[--at] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    print(text + at);
}

void print_hex(uint64_t number, int digits) {
    char text[17];
    text[digits] = 0;
    for (int at = digits; at-- > 0; number >>= 4) text[at] = "0123456789abcdef"[number & 15];
    print(text);
}

void board_exit(int code) {
    const uint32_t reason[2] = {0x20026, (uint32_t)code}; /* the application ended */
    semihosting(0x20, reason);
    for (;;) {
    }
}

static void fault(void) {
    print("fault\n");
    board_exit(3);
}

/* Takes the place of the library's own, which stops in a loop. */
void rf_panic(void) {
    print("panic\n");
    board_exit(4);
}

uint32_t instructions(void) {
    static uint32_t last, per_tick;
    if (!per_tick) {
        /* Two instructions a round. */
        const uint32_t start = SYST_CVR;
        __asm__ volatile("1: subs %0, #1\n bne 1b" : "+r"((uint32_t){1 << 20})::"cc");
        const uint32_t ticks = (start - SYST_CVR) & 0xffffff;
        per_tick = ticks ? ((2u << 20) + ticks / 2) / ticks : 1;
    }
    const uint32_t now = SYST_CVR, passed = (last - now) & 0xffffff;
    last = now;
    return passed * per_tick;
}

uint32_t stack_high_water(void) {
    const volatile uint32_t *at = stack_bottom;
    while (at < stack_top && *at == PAINT) at++;
    return (uint32_t)((const volatile uint8_t *)stack_top - (const volatile uint8_t *)at);
}
