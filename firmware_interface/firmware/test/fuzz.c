/* Random sessions against the whole core, with the invariants checked after every run.
 *
 * Usage: fuzz FRAMES SEED. Frames are mostly well formed, so that they get past the CRC, with
 * fields at and around the limits; some are damaged on the line. Meant to be built with
 * -fsanitize=address,undefined.
 */
#include <stdio.h>
#include <stdlib.h>

#include "abt_firmware.h"

static const abt_config CONFIG = {
    .valve_count = 8, .opposing = {32, 16, 128, 64, 2, 1, 8, 4},
    .bearing_after_trip = ABT_BEARING_POLICY_DROP, .land_after_us = 30000,
    .min_on_us = 5000, .min_off_us = 3000, .dead_us = 2000, .max_on_us = 60000,
    .duty_window_us = 320000, .duty_budget_us = 150000, .max_ttl_us = 200000,
    .watchdog_us = 50000, .undervoltage_mv = 9000, .undervoltage_us = 1500,
    .status_period_us = 50000,
};

typedef struct {
    abt_firmware firmware;
    abt_outputs outputs;
    uint32_t now_us;
    abt_sensors sensors;
    uint64_t random;
    uint16_t seq;
    uint32_t plan;
    /* what an observer of bytes and pins knows */
    uint8_t mask;
    uint32_t opened_us[8], closed_us[8];
    bool ever_closed[8];
    uint32_t accepted_us; /* newest CMD answered OK or REFRESHED, or ARM */
    uint32_t ends_us; /* of the newest plan answered OK */
    uint32_t sent_age_us, sent_ttl_us; /* of the newest frame, if it was a CMD */
    bool was_armed; /* before the newest frame */
    uint64_t open_us;
    uint32_t depth;
} world;

static void enter(void *context)
{
    ((world *)context)->depth++;
}

static void leave(void *context)
{
    ((world *)context)->depth--;
}

static uint32_t draw(world *w, uint32_t below)
{
    w->random ^= w->random << 13; /* xorshift64 of G. Marsaglia, J. Stat. Software 8(14), 2003 */
    w->random ^= w->random >> 7;
    w->random ^= w->random << 17;
    return (uint32_t)(w->random >> 32) % below;
}

static void demand(const world *w, bool kept, const char *what)
{
    if (!kept) {
        printf("broken at %u us, mask %02x: %s\n", w->now_us, w->mask, what);
        exit(1);
    }
}

static void note_edges(world *w, uint8_t mask)
{
    for (unsigned i = 0; i < 8; i++) {
        const unsigned bit = 1u << i;
        if (mask & ~w->mask & bit) {
            for (unsigned j = 0; j < 8; j++) {
                demand(w, !(CONFIG.opposing[i] >> j & 1) || !w->ever_closed[j] ||
                              w->now_us - w->closed_us[j] >= CONFIG.dead_us, "dead time");
            }
            if (!w->ever_closed[i] || w->now_us != w->closed_us[i]) { /* else the same opening */
                demand(w, !w->ever_closed[i] || w->now_us - w->closed_us[i] >= CONFIG.min_off_us,
                       "minimum off-time");
                w->opened_us[i] = w->now_us;
            }
        }
        if (w->mask & ~mask & bit) {
            w->closed_us[i] = w->now_us;
            w->ever_closed[i] = true;
        }
    }
    w->mask = mask;
}

static void check(world *w)
{
    const abt_control *control = &w->firmware.control;
    demand(w, w->mask == 0 || control->state == ABT_STATE_ARMED, "open though not armed");
    demand(w, w->mask == 0 || w->now_us - w->accepted_us < CONFIG.watchdog_us, "watchdog");
    demand(w, w->mask == 0 || !abt_reached(w->now_us, w->ends_us), "open past its time to live");
    demand(w, w->depth == 0, "critical section left open");
    for (unsigned i = 0; i < 8; i++) {
        if (w->mask >> i & 1) {
            demand(w, !(w->mask & CONFIG.opposing[i]), "two opposing valves");
            demand(w, w->now_us - w->opened_us[i] < CONFIG.max_on_us, "maximum on-time");
        }
    }
}

static void run(world *w)
{
    w->outputs = abt_run(&w->firmware, w->now_us, w->sensors);
    note_edges(w, w->outputs.mask);
    demand(w, !(w->firmware.control.faults & ABT_FAULT_INTERLOCK), "output stage had to step in");
    check(w);
}

static void pass(world *w, uint32_t us)
{
    const uint32_t until_us = w->now_us + us;
    while (abt_reached(until_us, w->outputs.wake_us)) {
        demand(w, w->outputs.wake_us - w->now_us <= ABT_HOUSEKEEPING_US, "housekeeping");
        w->open_us += w->mask ? w->outputs.wake_us - w->now_us : 0;
        w->now_us = w->outputs.wake_us;
        run(w);
    }
    w->open_us += w->mask ? until_us - w->now_us : 0;
    w->now_us = until_us;
}

static uint32_t time_like(world *w)
{
    static const uint32_t SPECIAL[] = {0, 0, 0, 1, 4999, 5000, 5001, 2000, 60000, 60001, 50000,
                                       200000, 10000000, 10000001, 0xffffffffu};
    const uint32_t sort = draw(w, 40);
    return sort < 15 ? SPECIAL[sort] : draw(w, 60000);
}

static void fill(world *w, abt_frame *frame)
{
    const uint32_t session = draw(w, 50) ? w->firmware.session.session : draw(w, 1000);
    abt_cmd cmd = {.session = session, .plan = w->plan, .ttl_us = 1 + draw(w, 199999)};
    cmd.plan += draw(w, 3) ? 1 : 0;
    cmd.plan -= draw(w, 50) ? 0 : draw(w, 5);
    cmd.age_us = draw(w, 3) ? 0 : draw(w, 30000);
    for (unsigned i = 0; i < 8; i++) {
        const bool one = draw(w, 3) == 0;
        cmd.on_us[i] = one ? (draw(w, 10) ? draw(w, 60000) : time_like(w)) : 0;
        cmd.offset_us[i] = draw(w, 2) ? (draw(w, 10) ? draw(w, 40000) : time_like(w)) : 0;
    }
    w->plan = draw(w, 50) ? cmd.plan : w->plan;
    w->sent_age_us = cmd.age_us;
    w->sent_ttl_us = cmd.ttl_us;
    abt_cmd_pack(&cmd, frame->payload); /* ARM and BEARING begin the same way */
    const uint32_t sort = draw(w, 100);
    frame->type = ABT_TYPE_CMD;
    if (sort < 8) { frame->type = ABT_TYPE_ARM; }
    if (sort == 8) { frame->type = ABT_TYPE_DISARM; }
    if (sort == 9) { frame->type = ABT_TYPE_HELLO; }
    if (sort == 10) { frame->type = ABT_TYPE_BEARING; frame->payload[4] = (uint8_t)draw(w, 3); }
    if (sort == 11) { frame->type = ABT_TYPE_PING; }
    if (sort == 12) { frame->type = (uint8_t)draw(w, 256); }
    const uint8_t size = abt_payload_size(frame->type);
    frame->payload_size = size == ABT_NO_SUCH_TYPE ? 4 : size;
    frame->payload_size = draw(w, 200) ? frame->payload_size : (uint8_t)draw(w, 81);
}

/* Believe the answers on the line, not the firmware's memory. */
static void listen(world *w)
{
    static abt_decoder decoder;
    uint8_t bytes[ABT_FRAME_MAX];
    size_t size;
    while ((size = abt_transmit(&w->firmware, w->now_us, bytes)) > 0) {
        for (size_t i = 0; i < size; i++) {
            abt_frame frame;
            const abt_frame_result result = abt_decode(&decoder, bytes[i], &frame);
            demand(w, result == ABT_FRAME_NONE || result == ABT_FRAME_GOOD, "own frame unreadable");
            if (result == ABT_FRAME_GOOD && frame.type == ABT_TYPE_ACK) {
                abt_ack ack;
                abt_ack_unpack(frame.payload, &ack);
                const bool played = ack.result == ABT_RESULT_OK && ack.type == ABT_TYPE_CMD;
                const bool armed = ack.result == ABT_RESULT_OK && ack.type == ABT_TYPE_ARM;
                if (played || ack.result == ABT_RESULT_REFRESHED || (armed && !w->was_armed)) {
                    w->accepted_us = ack.t2_us;
                }
                if (played) {
                    w->ends_us = ack.t2_us - w->sent_age_us + w->sent_ttl_us;
                }
            }
        }
    }
}

static void send_frame(world *w)
{
    abt_frame frame = {0};
    uint8_t bytes[ABT_FRAME_MAX];
    fill(w, &frame);
    w->seq = (uint16_t)(w->seq + (draw(w, 100) ? 1u : draw(w, 4)));
    frame.seq = w->seq;
    frame.t_us = w->now_us;
    const size_t size = abt_encode(&frame, bytes);
    if (draw(w, 20) == 0) {
        bytes[draw(w, (uint32_t)size)] ^= (uint8_t)(1u << draw(w, 8));
    }
    const size_t heard = draw(w, 50) ? size : draw(w, (uint32_t)size);
    w->was_armed = w->firmware.control.state == ABT_STATE_ARMED;
    const bool at_once = abt_receive(&w->firmware, w->now_us, bytes, heard);
    listen(w);
    if (at_once) {
        run(w);
    }
}

int main(int count, char **argument)
{
    static world w;
    const uint32_t frames = count > 1 ? (uint32_t)strtoul(argument[1], NULL, 10) : 500000u;
    w.random = 88172645463325252ull + (count > 2 ? strtoul(argument[2], NULL, 10) : 0);
    w.now_us = 0xfff00000u; /* wraps soon */
    w.sensors = (abt_sensors){12000, 500000};
    const abt_identity identity = {1, 2, ABT_RESET_CAUSE_POWER_ON};
    abt_init(&w.firmware, &CONFIG, &identity, (abt_port){enter, leave, &w}, w.now_us);
    run(&w);
    for (uint32_t i = 0; i < frames; i++) {
        if (draw(&w, 100) == 0) {
            w.sensors.supply_mv = draw(&w, 4) ? 12000 : 8000;
        }
        send_frame(&w);
        pass(&w, draw(&w, 10) ? draw(&w, 8000) : draw(&w, 80000));
    }
    printf("%u frames, %llu us open\n", frames, (unsigned long long)w.open_us);
    return 0;
}
