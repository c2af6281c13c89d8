/* Clock and alarm by SysTick, for QEMU: its TIM2 counts at a rate of its own and has no alarm.
 *
 * Alarms come at whole milliseconds, and late by up to one. Not for a board.
 */
#include "timer.h"

#include "registers.h"

#define CORE_MHZ 168u /* what QEMU's netduinoplus2 runs at, whatever it is told */

static volatile uint32_t ticks_ms;
static volatile uint32_t alarm_us;

void SysTick_Handler(void);

void timer_start(uint32_t timer_hz)
{
    (void)timer_hz;
    SYSTICK_RVR = CORE_MHZ * 1000u - 1u;
    SYSTICK_CVR = 0;
    SCB_SYSTICK_PRIORITY = ALARM_PRIORITY;
    SYSTICK_CSR = SYSTICK_CSR_CORE_CLOCK | SYSTICK_CSR_TICKINT | SYSTICK_CSR_ENABLE;
}

uint32_t timer_now_us(void)
{
    return ticks_ms * 1000u;
}

void timer_set_alarm(uint32_t wake_us)
{
    alarm_us = wake_us;
}

void timer_trigger(void)
{
    alarm_us = ticks_ms * 1000u; /* due at once, also if the next tick comes first */
    SCB_ICSR = SCB_ICSR_PENDSTSET;
    __asm__ volatile("dsb\n\tisb" ::: "memory");
}

void SysTick_Handler(void)
{
    /* Set by the counter alone, not by PENDSTSET; reading clears it. */
    if (SYSTICK_CSR & (1u << 16)) {
        ticks_ms++;
    }
    if (ticks_ms * 1000u - alarm_us < 0x80000000u) {
        timer_alarm();
    }
}
