#include "abt_valves.h"

static uint32_t later(uint32_t a_us, uint32_t b_us)
{
    return abt_reached(a_us, b_us) ? a_us : b_us;
}

static uint32_t sooner(uint32_t a_us, uint32_t b_us)
{
    return abt_reached(a_us, b_us) ? b_us : a_us;
}

/* ---- Open time and duty ------------------------------------------------------------------- */

static uint32_t slot_length_us(const abt_valves *valves)
{
    return valves->config->duty_window_us / ABT_DUTY_SLOTS;
}

/* Add the time since the last count to what is open, then turn to the next slot when it is due. */
static void count_open_time(abt_valves *valves, uint32_t now_us)
{
    const uint32_t passed_us = now_us - valves->counted_us;
    valves->counted_us = now_us;
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        abt_valve *valve = &valves->valve[i];
        if (valve->open) {
            valve->open_total_us += passed_us;
            valve->duty_us[valves->slot] += passed_us;
            valve->duty_sum_us += passed_us;
        }
    }
    if (now_us - valves->slot_us < slot_length_us(valves)) {
        return;
    }
    valves->slot_us = now_us;
    valves->slot = valves->slot == ABT_DUTY_SLOTS ? 0 : (uint8_t)(valves->slot + 1u);
    for (unsigned i = 0; i < ABT_VALVES; i++) { /* the oldest slot is the next one */
        abt_valve *valve = &valves->valve[i];
        valve->duty_sum_us -= valve->duty_us[valves->slot];
        valve->duty_us[valves->slot] = 0;
    }
}

static uint32_t duty_left_us(const abt_valves *valves, const abt_valve *valve)
{
    const uint32_t budget_us = valves->config->duty_budget_us;
    return valve->duty_sum_us >= budget_us ? 0 : budget_us - valve->duty_sum_us;
}

/* ---- One valve ---------------------------------------------------------------------------- */

static void open_valve(abt_valve *valve, uint32_t now_us)
{
    valve->open = true;
    valve->due = false;
    valve->opened_us = now_us;
}

static void close_valve(abt_valve *valve, uint32_t now_us)
{
    valve->open = false;
    valve->resting = true;
    valve->cut = false;
    valve->closed_us = now_us;
}

static bool opposing_open(const abt_valves *valves, unsigned i)
{
    return (abt_valves_mask(valves) & valves->config->opposing[i]) != 0;
}

/* The first instant at which valve i may open, as far as the past is concerned. */
static uint32_t free_us(const abt_valves *valves, unsigned i, uint32_t us)
{
    const abt_config *config = valves->config;
    if (valves->valve[i].resting) {
        us = later(us, valves->valve[i].closed_us + config->min_off_us);
    }
    for (unsigned j = 0; j < ABT_VALVES; j++) {
        if ((config->opposing[i] & abt_bit(j)) && valves->valve[j].resting) {
            us = later(us, valves->valve[j].closed_us + config->dead_us);
        }
    }
    return us;
}

/* The end of an opening, by its plan or by a limit, whichever is first. */
static uint32_t close_us(const abt_valves *valves, const abt_valve *valve)
{
    const uint32_t limit_us = valve->opened_us + valves->config->max_on_us;
    const uint32_t duty_us = valves->counted_us + duty_left_us(valves, valve);
    return sooner(valve->down_us, sooner(limit_us, duty_us));
}

static void close_if_due(abt_valves *valves, abt_valve *valve, uint32_t now_us)
{
    if (!valve->open || !abt_reached(now_us, close_us(valves, valve))) {
        return;
    }
    close_valve(valve, now_us);
    if (abt_reached(now_us, valve->down_us)) {
        return;
    }
    valve->cut = true;
    if (now_us - valve->opened_us >= valves->config->max_on_us) {
        valves->cut_max_on++;
    } else {
        valves->cut_duty++;
    }
}

/* Whether what is left of a pulse from `open_us` on is worth opening the valve for. */
static bool worth_opening(const abt_valves *valves, const abt_valve *valve, uint32_t open_us)
{
    const uint32_t min_on_us = valves->config->min_on_us;
    const uint32_t duty_us = duty_left_us(valves, valve);
    return valve->down_us - open_us >= min_on_us && duty_us >= min_on_us && duty_us > 0;
}

static void open_if_due(abt_valves *valves, unsigned i, uint32_t now_us)
{
    abt_valve *valve = &valves->valve[i];
    const uint32_t open_us = free_us(valves, i, valve->up_us);
    const bool over = abt_reached(now_us, valve->down_us);
    if (!valve->due || (!over && (opposing_open(valves, i) || !abt_reached(now_us, open_us)))) {
        return;
    }
    if (!over && worth_opening(valves, valve, open_us)) {
        open_valve(valve, now_us);
    } else {
        valve->due = false;
        valves->unplayed++;
    }
}

/* ---- Plans -------------------------------------------------------------------------------- */

/* Whether valve i is open, or was closed by its plan no sooner than the new plan came in. */
static bool still_open(const abt_valves *valves, unsigned i, uint32_t received_us)
{
    const abt_valve *valve = &valves->valve[i];
    const bool just_closed =
        valve->resting && !valve->cut && abt_reached(valve->closed_us, received_us);
    return valve->open || (just_closed && !opposing_open(valves, i));
}

/* No new opening, so no minimum applies and `opened_us` stays. */
static void continue_opening(abt_valve *valve, uint32_t down_us)
{
    valve->open = true;
    valve->due = false;
    valve->down_us = down_us;
}

static void take_pulse(abt_valves *valves, unsigned i, const abt_plan *plan, uint32_t now_us)
{
    abt_valve *valve = &valves->valve[i];
    const uint32_t on_us = plan->on_us[i];
    const uint32_t up_us = later(plan->start_us + plan->offset_us[i], plan->received_us);
    const uint32_t down_us = sooner(plan->start_us + plan->offset_us[i] + on_us, plan->end_us);
    if (up_us == plan->received_us && !abt_reached(up_us, down_us) &&
        still_open(valves, i, plan->received_us)) {
        continue_opening(valve, down_us);
        return;
    }
    if (valve->open) {
        close_valve(valve, now_us);
    }
    valve->due = on_us > 0;
    valve->up_us = up_us;
    valve->down_us = down_us;
}

void abt_valves_init(abt_valves *valves, const abt_config *config, uint32_t now_us)
{
    *valves = (abt_valves){.config = config, .counted_us = now_us, .slot_us = now_us};
}

void abt_valves_take(abt_valves *valves, const abt_plan *plan, uint32_t now_us)
{
    count_open_time(valves, now_us);
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        take_pulse(valves, i, plan, now_us);
    }
}

/* Forget closings too long ago to matter, before their stamps wrap. */
static void forget_rest(abt_valves *valves, uint32_t now_us)
{
    const uint32_t rest_us = later(valves->config->min_off_us, valves->config->dead_us);
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        abt_valve *valve = &valves->valve[i];
        if (now_us - valve->closed_us > rest_us) {
            valve->resting = false;
        }
    }
}

void abt_valves_run(abt_valves *valves, uint32_t now_us)
{
    count_open_time(valves, now_us);
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        close_if_due(valves, &valves->valve[i], now_us);
    }
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        open_if_due(valves, i, now_us);
    }
    forget_rest(valves, now_us);
}

void abt_valves_close(abt_valves *valves, uint32_t now_us)
{
    count_open_time(valves, now_us);
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        valves->valve[i].due = false;
        if (valves->valve[i].open) {
            close_valve(&valves->valve[i], now_us);
        }
        valves->valve[i].cut = true; /* nothing continues after this */
    }
    forget_rest(valves, now_us);
}

uint32_t abt_valves_wake(const abt_valves *valves, uint32_t latest_us)
{
    uint32_t wake_us = sooner(latest_us, valves->slot_us + slot_length_us(valves));
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        const abt_valve *valve = &valves->valve[i];
        if (valve->open) {
            wake_us = sooner(wake_us, close_us(valves, valve));
        } else if (valve->due && !opposing_open(valves, i)) { /* else its closing is waited for */
            wake_us = sooner(wake_us, free_us(valves, i, valve->up_us));
        }
    }
    return wake_us;
}

uint8_t abt_valves_mask(const abt_valves *valves)
{
    unsigned mask = 0;
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        mask |= valves->valve[i].open ? abt_bit(i) : 0u;
    }
    return (uint8_t)mask;
}
