/* What the outputs are: BOOT, SAFE or ARMED, watchdog, supply, interlock, bearing air.
 *
 * Written by abt_run, and by the main loop inside the critical section.
 */
#ifndef ABT_CONTROL_H
#define ABT_CONTROL_H

#include "abt_output.h"
#include "abt_valves.h"

#define ABT_HOUSEKEEPING_US 1000u /* runs are never further apart */
#define ABT_EDGE_RING 64u

typedef struct {
    uint16_t supply_mv;
    uint32_t supply_pa;
} abt_sensors;

typedef struct {
    uint8_t mask; /* valves to be open */
    bool bearing;
    uint32_t wake_us; /* run again then */
} abt_outputs;

typedef struct {
    const abt_config *config;
    abt_state state;
    uint8_t faults;
    bool bearing;
    bool landing; /* bearing air goes off at `land_us` */
    bool plan_waiting; /* `plan` is for the next run */
    bool close_waiting; /* the next run closes everything first */
    bool plan_known; /* `plan_id` is one of this session */
    bool supply_low; /* since `low_since_us` */
    uint32_t plan_id;
    abt_plan plan;
    uint32_t fed_us; /* watchdog */
    uint32_t low_since_us;
    uint32_t land_us;
    uint32_t wake_us; /* what the last run asked for */
    uint32_t worst_late_us;
    uint16_t watchdog_trips;
    uint16_t lost_edges;
    abt_sensors sensors;
    abt_valves valves;
    abt_output output;
    uint32_t edge_us[ABT_EDGE_RING];
    uint8_t edge_mask[ABT_EDGE_RING];
    uint8_t edge_first;
    uint8_t edge_count;
} abt_control;

/* All closed, and SAFE if the limits agree with each other, else BOOT for good. */
void abt_control_init(abt_control *control, const abt_config *config, uint32_t now_us);

/* Let time pass. */
abt_outputs abt_control_run(abt_control *control, uint32_t now_us, abt_sensors sensors);

/* Bearing air as a sender wants it, who is alive: no landing. */
void abt_control_bearing(abt_control *control, bool on);

abt_result abt_control_arm(abt_control *control, uint32_t now_us);

/* The next run closes everything, even if ARM comes before it. */
void abt_control_disarm(abt_control *control);

/* A command that abt_cmd_check let through. */
abt_result abt_control_offer(abt_control *control, const abt_cmd *cmd, uint32_t now_us);

#endif
