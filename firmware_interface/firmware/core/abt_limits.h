/* The board's limits: whether they agree with each other, and whether a command keeps them. */
#ifndef ABT_LIMITS_H
#define ABT_LIMITS_H

#include "abt_messages.h"

#define ABT_DUTY_SLOTS 16u /* a duty window is counted in so many slots, and the running one */

static inline uint8_t abt_bit(unsigned valve)
{
    return (uint8_t)(1u << valve);
}

/* Whether the limits can be kept all at once; no plan may be played if not. */
bool abt_config_valid(const abt_config *config);

/* CRC-32 of the limits record: both sides check that they mean the same vehicle. */
uint32_t abt_config_hash(const abt_config *config);

/* Whether a command may be played; ABT_RESULT_OK or the reason. */
abt_result abt_cmd_check(const abt_config *config, const abt_cmd *cmd);

#endif
