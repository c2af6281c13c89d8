/* Output stage: the interlock once more. It knows nothing of plans, only what it drove before. */
#ifndef ABT_OUTPUT_H
#define ABT_OUTPUT_H

#include "abt_limits.h"

typedef struct {
    uint8_t mask; /* valves driven open */
    uint8_t fallen; /* valves driven closed within the dead time, at `fell_us` */
    uint32_t fell_us[ABT_VALVES];
} abt_output;

/* Drive `mask`. If that would open opposing valves together, or within the dead time, drive
 * everything closed instead and return false. */
bool abt_output_step(abt_output *output, const abt_config *config, uint8_t mask, uint32_t now_us);

#endif
