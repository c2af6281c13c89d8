#include "abt_limits.h"

#include "abt_frame.h"

/* Each valve opposes those that oppose it; not itself, and none that is not there. */
static bool opposing_symmetric(const abt_config *config)
{
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        const uint8_t against = config->opposing[i];
        if ((against & abt_bit(i)) || (i >= config->valve_count && against)) {
            return false;
        }
        for (unsigned j = 0; j < ABT_VALVES; j++) {
            if ((against & abt_bit(j)) && !(config->opposing[j] & abt_bit(i))) {
                return false;
            }
        }
    }
    return true;
}

bool abt_config_valid(const abt_config *config)
{
    return abt_config_in_range(config) && config->max_on_us >= config->min_on_us &&
           config->duty_budget_us >= config->min_on_us &&
           config->duty_budget_us <= config->duty_window_us &&
           config->duty_window_us % ABT_DUTY_SLOTS == 0 && opposing_symmetric(config);
}

uint32_t abt_config_hash(const abt_config *config)
{
    uint8_t record[ABT_CONFIG_SIZE];
    abt_config_pack(config, record);
    return abt_crc32(record, ABT_CONFIG_SIZE);
}

/* Whether two pulses overlap, or follow each other within the dead time. */
static bool too_close(const abt_config *config, const abt_cmd *cmd, unsigned i, unsigned j)
{
    const uint32_t i_free_us = cmd->offset_us[i] + cmd->on_us[i] + config->dead_us;
    const uint32_t j_free_us = cmd->offset_us[j] + cmd->on_us[j] + config->dead_us;
    return cmd->on_us[i] > 0 && cmd->on_us[j] > 0 && cmd->offset_us[i] < j_free_us &&
           cmd->offset_us[j] < i_free_us;
}

static bool opposing_apart(const abt_config *config, const abt_cmd *cmd)
{
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        for (unsigned j = i + 1u; j < ABT_VALVES; j++) {
            if ((config->opposing[i] & abt_bit(j)) && too_close(config, cmd, i, j)) {
                return false;
            }
        }
    }
    return true;
}

abt_result abt_cmd_check(const abt_config *config, const abt_cmd *cmd)
{
    if (!abt_cmd_in_range(cmd)) {
        return ABT_RESULT_OUT_OF_RANGE;
    }
    if (cmd->ttl_us > config->max_ttl_us) {
        return ABT_RESULT_TTL_TOO_LONG;
    }
    if (cmd->age_us >= cmd->ttl_us) {
        return ABT_RESULT_EXPIRED;
    }
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        if (i >= config->valve_count && cmd->on_us[i] > 0) {
            return ABT_RESULT_NO_SUCH_VALVE;
        }
        if (cmd->on_us[i] > config->max_on_us) {
            return ABT_RESULT_ON_TOO_LONG;
        }
    }
    return opposing_apart(config, cmd) ? ABT_RESULT_OK : ABT_RESULT_OPPOSING;
}
