/* The board in virtual time, for a process that loads this as a shared library. */
#include <stdlib.h>
#include <string.h>

#include "abt_firmware.h"

#define EDGES_MAX 4096u
#define SENT_MAX 65536u

typedef struct {
    uint64_t t_us; /* since power came */
    uint32_t mask;
} edge;

typedef struct {
    abt_firmware firmware;
    uint64_t now_us;
    uint32_t clock_us; /* board's clock at now_us = 0 */
    abt_sensors sensors;
    abt_outputs outputs;
    uint32_t held; /* nothing is sent */
    uint32_t entered; /* depth of the critical section, for tests */
    uint32_t edge_count;
    edge edges[EDGES_MAX];
    uint32_t sent_count;
    uint8_t sent[SENT_MAX];
} board;

static void enter(void *context)
{
    ((board *)context)->entered++;
}

static void leave(void *context)
{
    ((board *)context)->entered--;
}

static uint32_t clock_of(const board *b)
{
    return (uint32_t)(b->clock_us + b->now_us);
}

static void drain(board *b)
{
    while (!b->held && b->sent_count + ABT_FRAME_MAX <= SENT_MAX) { /* else the line back is full */
        const size_t size = abt_transmit(&b->firmware, clock_of(b), b->sent + b->sent_count);
        if (size == 0) {
            return;
        }
        b->sent_count += (uint32_t)size;
    }
}

static void run(board *b)
{
    const uint8_t before = b->outputs.mask;
    b->outputs = abt_run(&b->firmware, clock_of(b), b->sensors);
    if (b->outputs.mask != before && b->edge_count < EDGES_MAX) {
        b->edges[b->edge_count++] = (edge){b->now_us, b->outputs.mask};
    }
    drain(b);
}

board *board_new(const uint8_t *config_record, uint32_t firmware_id, uint32_t boot_nonce,
                 uint32_t reset_cause, uint32_t clock_us, uint32_t supply_mv, uint32_t supply_pa)
{
    board *b = calloc(1, sizeof *b);
    if (!b) {
        return NULL;
    }
    abt_config config;
    abt_config_unpack(config_record, &config);
    const abt_identity identity = {firmware_id, boot_nonce, (abt_reset_cause)reset_cause};
    b->clock_us = clock_us;
    b->sensors = (abt_sensors){(uint16_t)supply_mv, supply_pa};
    abt_init(&b->firmware, &config, &identity, (abt_port){enter, leave, b}, clock_of(b));
    run(b);
    return b;
}

void board_free(board *b)
{
    free(b);
}

void board_sense(board *b, uint32_t supply_mv, uint32_t supply_pa)
{
    b->sensors = (abt_sensors){(uint16_t)supply_mv, supply_pa};
    run(b);
}

void board_feed(board *b, const uint8_t *bytes, uint32_t count)
{
    if (abt_receive(&b->firmware, clock_of(b), bytes, count)) {
        run(b);
    }
}

/* Run at every instant the firmware asks for, up to and with `until_us`. */
void board_run_until(board *b, uint64_t until_us)
{
    for (;;) {
        const uint32_t ahead_us = b->outputs.wake_us - clock_of(b);
        if (ahead_us > until_us - b->now_us) {
            break;
        }
        b->now_us += ahead_us;
        run(b);
    }
    b->now_us = until_us;
}

uint32_t board_take_edges(board *b, edge *out, uint32_t room)
{
    const uint32_t count = b->edge_count < room ? b->edge_count : room;
    memcpy(out, b->edges, count * sizeof *out);
    memmove(b->edges, b->edges + count, (b->edge_count - count) * sizeof *out);
    b->edge_count -= count;
    return count;
}

uint32_t board_take_bytes(board *b, uint8_t *out, uint32_t room)
{
    const uint32_t count = b->sent_count < room ? b->sent_count : room;
    memcpy(out, b->sent, count);
    memmove(b->sent, b->sent + count, b->sent_count - count);
    b->sent_count -= count;
    return count;
}

uint32_t board_bearing(const board *b)
{
    return b->outputs.bearing;
}

uint32_t board_entered(const board *b)
{
    return b->entered;
}

/* Fault injection: the line back is blocked. */
void board_hold(board *b, uint32_t held)
{
    b->held = held;
}

/* Fault injection: the alarm comes late. */
void board_oversleep(board *b, uint32_t late_us)
{
    b->now_us += b->outputs.wake_us - clock_of(b) + late_us;
    run(b);
}

/* Fault injection: the alarm does not come at all until something else makes it run. */
void board_skip(board *b, uint32_t us)
{
    b->now_us += us;
}

/* Fault injection: bits flip in the scheduler's memory. */
void board_flip_open(board *b, uint32_t valve)
{
    abt_valve *v = &b->firmware.control.valves.valve[valve];
    v->open = !v->open;
    v->opened_us = clock_of(b);
    v->down_us = clock_of(b) + 1000u;
    run(b);
}
