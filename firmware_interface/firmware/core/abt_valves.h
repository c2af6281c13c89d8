/* When each valve opens and closes: plays plans within the limits of the configuration.
 *
 * The port runs it at the instants it asks for (abt_valves_wake), so that edges come at whole
 * microseconds and not at ticks. Times are u32 microseconds that wrap after 71.6 minutes; two of
 * them are compared by their difference, which must stay below 35 minutes. A stamp that could grow
 * older than that carries a flag that says whether it still matters.
 */
#ifndef ABT_VALVES_H
#define ABT_VALVES_H

#include "abt_limits.h"

static inline bool abt_reached(uint32_t now_us, uint32_t then_us)
{
    return now_us - then_us < 0x80000000u;
}

/* A pulse per valve, from abt_cmd; on_us = 0 is none. */
typedef struct {
    uint32_t received_us; /* nothing of the plan happens before */
    uint32_t start_us; /* offsets count from here */
    uint32_t end_us; /* all closed */
    uint32_t on_us[ABT_VALVES];
    uint32_t offset_us[ABT_VALVES];
} abt_plan;

typedef struct {
    bool open;
    bool due; /* a pulse is still to be opened, at `up_us` */
    bool resting; /* closed so recently that `closed_us` matters */
    bool cut; /* closed by a limit, not by its plan */
    uint32_t up_us;
    uint32_t down_us; /* end of the pulse */
    uint32_t opened_us;
    uint32_t closed_us;
    uint32_t open_total_us; /* since boot, wraps */
    uint32_t duty_us[ABT_DUTY_SLOTS + 1u]; /* open time per slot */
    uint32_t duty_sum_us;
} abt_valve;

typedef struct {
    const abt_config *config;
    abt_valve valve[ABT_VALVES];
    uint32_t counted_us; /* open times are counted up to here */
    uint32_t slot_us; /* when the running duty slot began */
    uint8_t slot;
    uint16_t unplayed;
    uint16_t cut_max_on;
    uint16_t cut_duty;
} abt_valves;

void abt_valves_init(abt_valves *valves, const abt_config *config, uint32_t now_us);

/* Replace the plan being played. What it does not continue closes at once. */
void abt_valves_take(abt_valves *valves, const abt_plan *plan, uint32_t now_us);

/* Close what is due, then open what is due. */
void abt_valves_run(abt_valves *valves, uint32_t now_us);

/* Close everything and forget the plan. */
void abt_valves_close(abt_valves *valves, uint32_t now_us);

/* The next instant at which a run changes something; `latest_us` if that is sooner. */
uint32_t abt_valves_wake(const abt_valves *valves, uint32_t latest_us);

uint8_t abt_valves_mask(const abt_valves *valves);

#endif
