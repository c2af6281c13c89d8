#include "abt_control.h"

void abt_control_init(abt_control *control, const abt_config *config, uint32_t now_us)
{
    const bool valid = abt_config_valid(config);
    *control = (abt_control){
        .config = config,
        .state = valid ? ABT_STATE_SAFE : ABT_STATE_BOOT,
        .faults = valid ? 0 : ABT_FAULT_CONFIG,
        .wake_us = now_us,
    };
    abt_valves_init(&control->valves, config, now_us);
}

static void trip(abt_control *control, abt_fault fault, uint32_t now_us)
{
    control->state = ABT_STATE_SAFE;
    control->faults = (uint8_t)(control->faults | fault);
    control->plan_waiting = false;
    control->landing = control->config->bearing_after_trip == ABT_BEARING_POLICY_DROP;
    control->land_us = now_us + control->config->land_after_us;
}

static void judge_supply(abt_control *control, uint32_t now_us, abt_sensors sensors)
{
    const bool low = sensors.supply_mv < control->config->undervoltage_mv;
    if (!control->supply_low) {
        control->low_since_us = now_us;
    }
    control->supply_low = low;
    control->sensors = sensors;
    if (low && control->state == ABT_STATE_ARMED &&
        now_us - control->low_since_us >= control->config->undervoltage_us) {
        trip(control, ABT_FAULT_UNDERVOLTAGE, now_us);
    }
}

static void judge_watchdog(abt_control *control, uint32_t now_us)
{
    if (control->state == ABT_STATE_ARMED &&
        abt_reached(now_us, control->fed_us + control->config->watchdog_us)) {
        trip(control, ABT_FAULT_WATCHDOG, now_us);
        control->watchdog_trips++;
    }
}

static void move_valves(abt_control *control, uint32_t now_us)
{
    if (control->state != ABT_STATE_ARMED || control->close_waiting) {
        abt_valves_close(&control->valves, now_us);
    }
    control->close_waiting = false;
    if (control->state != ABT_STATE_ARMED) {
        return;
    }
    if (control->plan_waiting) {
        control->plan_waiting = false;
        abt_valves_take(&control->valves, &control->plan, now_us);
    }
    abt_valves_run(&control->valves, now_us);
}

static void note_edge(abt_control *control, uint32_t now_us, uint8_t mask)
{
    if (control->edge_count == ABT_EDGE_RING) {
        control->lost_edges++;
        return;
    }
    const unsigned at = (control->edge_first + (unsigned)control->edge_count) % ABT_EDGE_RING;
    control->edge_us[at] = now_us;
    control->edge_mask[at] = mask;
    control->edge_count++;
}

static void drive(abt_control *control, uint32_t now_us)
{
    const uint8_t before = control->output.mask;
    const uint8_t wanted = abt_valves_mask(&control->valves);
    if (!abt_output_step(&control->output, control->config, wanted, now_us)) {
        trip(control, ABT_FAULT_INTERLOCK, now_us);
        abt_valves_close(&control->valves, now_us);
    }
    if (control->output.mask != before) {
        note_edge(control, now_us, control->output.mask);
    }
}

/* After the valves: a trip of this run may land at once. */
static void judge_landing(abt_control *control, uint32_t now_us)
{
    if (control->landing && abt_reached(now_us, control->land_us)) {
        abt_control_bearing(control, false);
    }
}

static uint32_t next_wake_us(const abt_control *control, uint32_t now_us)
{
    uint32_t wake_us = now_us + ABT_HOUSEKEEPING_US;
    const uint32_t bite_us = control->fed_us + control->config->watchdog_us;
    const uint32_t low_us = control->low_since_us + control->config->undervoltage_us;
    if (control->state != ABT_STATE_ARMED) {
        return wake_us;
    }
    if (abt_reached(wake_us, bite_us)) {
        wake_us = bite_us;
    }
    if (control->supply_low && abt_reached(wake_us, low_us)) {
        wake_us = low_us;
    }
    return abt_valves_wake(&control->valves, wake_us);
}

static void note_lateness(abt_control *control, uint32_t now_us)
{
    if (abt_reached(now_us, control->wake_us) &&
        now_us - control->wake_us > control->worst_late_us) {
        control->worst_late_us = now_us - control->wake_us;
    }
}

abt_outputs abt_control_run(abt_control *control, uint32_t now_us, abt_sensors sensors)
{
    if (control->state != ABT_STATE_BOOT) {
        note_lateness(control, now_us);
        judge_supply(control, now_us, sensors);
        judge_watchdog(control, now_us);
        move_valves(control, now_us);
        drive(control, now_us);
        judge_landing(control, now_us);
    }
    control->wake_us = next_wake_us(control, now_us);
    return (abt_outputs){control->output.mask, control->bearing, control->wake_us};
}

/* ---- What the host asks for --------------------------------------------------------------- */

void abt_control_bearing(abt_control *control, bool on)
{
    control->bearing = on;
    control->landing = false;
}

abt_result abt_control_arm(abt_control *control, uint32_t now_us)
{
    if (control->state == ABT_STATE_BOOT) {
        return ABT_RESULT_CONFIG_FAULT;
    }
    if (control->supply_low) {
        return ABT_RESULT_UNDERVOLTAGE;
    }
    if (control->state == ABT_STATE_SAFE) {
        control->state = ABT_STATE_ARMED;
        control->faults = 0;
        control->landing = false;
        control->fed_us = now_us;
    }
    return ABT_RESULT_OK;
}

void abt_control_disarm(abt_control *control)
{
    if (control->state == ABT_STATE_ARMED) {
        control->state = ABT_STATE_SAFE;
    }
    control->plan_waiting = false;
    control->close_waiting = true; /* ARM may follow before the next run */
}

abt_result abt_control_offer(abt_control *control, const abt_cmd *cmd, uint32_t now_us)
{
    if (control->state != ABT_STATE_ARMED) {
        return ABT_RESULT_NOT_ARMED;
    }
    if (control->plan_known && !abt_reached(cmd->plan, control->plan_id)) {
        return ABT_RESULT_STALE_PLAN;
    }
    control->fed_us = now_us;
    if (control->plan_known && cmd->plan == control->plan_id) {
        return ABT_RESULT_REFRESHED;
    }
    control->plan_known = true;
    control->plan_id = cmd->plan;
    control->plan_waiting = true;
    control->plan.received_us = now_us;
    control->plan.start_us = now_us - cmd->age_us;
    control->plan.end_us = control->plan.start_us + cmd->ttl_us;
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        control->plan.on_us[i] = cmd->on_us[i];
        control->plan.offset_us[i] = cmd->offset_us[i];
    }
    return ABT_RESULT_OK;
}
