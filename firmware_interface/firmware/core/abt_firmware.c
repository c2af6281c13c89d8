#include "abt_firmware.h"

void abt_init(abt_firmware *firmware, const abt_config *config, const abt_identity *identity,
              abt_port port, uint32_t now_us)
{
    *firmware = (abt_firmware){.config = *config, .identity = *identity, .port = port};
    firmware->outbox.status_us = now_us;
    abt_control_init(&firmware->control, &firmware->config, now_us);
}

abt_outputs abt_run(abt_firmware *firmware, uint32_t now_us, abt_sensors sensors)
{
    return abt_control_run(&firmware->control, now_us, sensors);
}
