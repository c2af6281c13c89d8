/* The board's clock in microseconds and its one alarm. */
#ifndef TIMER_H
#define TIMER_H

#include <stdint.h>

/* Lower numbers come first. */
#define LINE_PRIORITY 0x40u
#define ALARM_PRIORITY 0x80u

void timer_start(uint32_t timer_hz);

uint32_t timer_now_us(void);

/* Call `timer_alarm` then; at once if it is past already. */
void timer_set_alarm(uint32_t wake_us);

/* Call `timer_alarm` at once. */
void timer_trigger(void);

/* The port's: runs in the interrupt. */
void timer_alarm(void);

#endif
