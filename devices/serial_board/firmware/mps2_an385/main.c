/* A whole firmware: the core on a Cortex-M3 without an operating system, with a simulated axis in place of hardware.
 *
 * Arm's MPS2 board AN385, as QEMU emulates it (qemu-system-arm -M mps2-an385): UART0 talks to the host, timer 0 is the
 * clock. For a board of your own replace the four functions that touch registers, and `measure` and `exert`.
 */
#include <stdint.h>

#include "../mhb.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u) /* bit 0: no room to send; bit 1: a byte has come */
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_DIVIDER REGISTER(0x40004010u)
#define TIMER_CONTROL REGISTER(0x40000000u)
#define TIMER_VALUE REGISTER(0x40000004u) /* counts down */
#define TIMER_RELOAD REGISTER(0x40000008u)

enum { TICKS_PER_US = 25, PERIOD_US = 1000, LONGEST_US = 50000 };

static void start(void) {
    UART_DIVIDER = 16;
    UART_CONTROL = 3;
    TIMER_RELOAD = 0xFFFFFFFFu;
    TIMER_VALUE = 0xFFFFFFFFu;
    TIMER_CONTROL = 1;
}

/* Microseconds since the start. The timer wraps after 172 s, so this is asked more often. */
static uint32_t micros(void) {
    static uint32_t last = 0xFFFFFFFFu, us, left;
    const uint32_t value = TIMER_VALUE;
    left += last - value;
    last = value;
    us += left / TICKS_PER_US;
    left %= TICKS_PER_US;
    return us;
}

static int has_byte(void) { return UART_STATE & 2u; }

static void send(const uint8_t *data, size_t length) {
    for (size_t i = 0; i < length; i++) {
        while (UART_STATE & 1u) continue;
        UART_DATA = data[i];
    }
}

/* The axis: 0.2 kg with 2 N s/m, at rest. A real one reads its encoder and writes its motor's current here. */
static float x, v, done_J;

static float measure(void) { return x; }

static void exert(float f, float dt) {
    v += dt * (f - 2.0f * v) / 0.2f;
    x += dt * v;
    done_J += f * dt * v;
}

int main(void) {
    static mhb board;
    static const mhb_about about = {
        .name = "mps2-an385", .axes = 1, .features = MHB_TELLS_WORK, .period_us = PERIOD_US, .longest_us = LONGEST_US,
        .force = {5.0f}, .displacement = {0.1f}, .speed = {2.0f}, .mass = {0.2f},
    };
    uint8_t frame[MHB_FRAME];
    start();
    if (mhb_init(&board, &about)) return 1;
    for (uint32_t due = micros();; due += PERIOD_US) {
        while ((int32_t)(micros() - due) < 0)
            while (has_byte()) mhb_take(&board, (uint8_t)UART_DATA, micros());
        const float *f = mhb_force(&board, micros()), f_now = *f;
        exert(f_now, 1e-6f * PERIOD_US);
        const float x_now = measure();
        send(frame, mhb_state(&board, micros(), &x_now, &f_now, MHB_CALIBRATED | MHB_READY, (int64_t)(1e9f * done_J), frame));
    }
}

/* --- what runs before main: the vectors, and memory as C expects it */

extern uint32_t stack_top[], data_begin[], data_end[], data_stored[], bss_begin[], bss_end[];

void reset(void);

void reset(void) {
    for (uint32_t *to = data_begin, *from = data_stored; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
    main();
    for (;;) continue;
}

static void hang(void) {
    for (;;) continue; /* the watchdog of a real board resets it here */
}

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    stack_top, reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, hang,
};
