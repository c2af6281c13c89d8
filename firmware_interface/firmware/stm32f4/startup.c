/* From reset to main, and what happens when something goes wrong. */
#include <stddef.h>
#include <stdint.h>

#include "board.h"

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];

int main(void);
void Reset_Handler(void);
void Fault_Handler(void);
void TIM2_IRQHandler(void) __attribute__((weak, alias("Fault_Handler")));
void SysTick_Handler(void) __attribute__((weak, alias("Fault_Handler")));
void USART1_IRQHandler(void);
void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

typedef void (*vector)(void);

/* Whatever is not named here is never enabled. */
static const struct {
    uint32_t *stack;
    vector exception[15];
    vector irq[USART1_IRQ + 1u];
} VECTORS __attribute__((section(".vectors"), used)) = {
    .stack = stack_top,
    .exception = {Reset_Handler, Fault_Handler, Fault_Handler, Fault_Handler, Fault_Handler,
                  Fault_Handler, NULL, NULL, NULL, NULL, Fault_Handler, Fault_Handler, NULL,
                  Fault_Handler, SysTick_Handler},
    .irq = {[TIM2_IRQ] = TIM2_IRQHandler, [USART1_IRQ] = USART1_IRQHandler},
};

static void start_independent_watchdog(void)
{
    IWDG_KR = IWDG_KR_START;
    IWDG_KR = IWDG_KR_UNLOCK;
    IWDG_PR = 0; /* 32 kHz / 4: 125 us per count */
    IWDG_RLR = 400u; /* 50 ms; the oscillator is good for 17 to 47 kHz: 34 to 94 ms */
    IWDG_KR = IWDG_KR_FEED;
}

void Reset_Handler(void)
{
    board_close_everything();
    start_independent_watchdog();
    for (uint32_t *to = data_start, *from = data_load; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end;) {
        *to++ = 0;
    }
    (void)main();
    Fault_Handler();
}

static void __attribute__((used, noreturn)) stop(void)
{
    __asm__ volatile("cpsid i");
    board_close_valves();
    for (;;) {
        __asm__ volatile("wfi"); /* until the independent watchdog resets the chip */
    }
}

/* Also when the stack is broken: it begins anew. A failed crystal comes here as NMI; after the
 * reset the board runs without it. */
void __attribute__((naked)) Fault_Handler(void)
{
    __asm__ volatile("ldr r0, =stack_top\n\t"
                     "mov sp, r0\n\t"
                     "b stop");
}

/* The compiler may ask for these for struct copies. */
void *memcpy(void *to, const void *from, size_t count)
{
    uint8_t *t = to;
    const uint8_t *f = from;
    while (count-- > 0) {
        *t++ = *f++;
    }
    return to;
}

void *memset(void *to, int value, size_t count)
{
    uint8_t *t = to;
    while (count-- > 0) {
        *t++ = (uint8_t)value;
    }
    return to;
}
