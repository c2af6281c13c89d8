#include "abt_output.h"

static void note_falls(abt_output *output, unsigned falling, uint32_t now_us)
{
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        if (falling & abt_bit(i)) {
            output->fallen = (uint8_t)(output->fallen | abt_bit(i));
            output->fell_us[i] = now_us;
        }
    }
}

static void forget_falls(abt_output *output, uint32_t dead_us, uint32_t now_us)
{
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        if (now_us - output->fell_us[i] >= dead_us) {
            output->fallen = (uint8_t)(output->fallen & ~abt_bit(i));
        }
    }
}

bool abt_output_step(abt_output *output, const abt_config *config, uint8_t mask, uint32_t now_us)
{
    const unsigned rising = mask & ~(unsigned)output->mask;
    bool apart = true;
    note_falls(output, output->mask & ~(unsigned)mask, now_us);
    forget_falls(output, config->dead_us, now_us);
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        const bool both = (mask & abt_bit(i)) && (mask & config->opposing[i]);
        const bool early = (rising & abt_bit(i)) && (output->fallen & config->opposing[i]);
        apart = apart && !both && !early;
    }
    if (!apart) {
        note_falls(output, output->mask, now_us);
        mask = 0;
    }
    output->mask = mask;
    return apart;
}
