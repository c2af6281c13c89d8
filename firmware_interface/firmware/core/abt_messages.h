/* Written by `python -m firmware_interface.generate` from messages.toml: change it there. */
#ifndef ABT_MESSAGES_H
#define ABT_MESSAGES_H

#include <stdbool.h>
#include <stdint.h>

#define ABT_VERSION 2u
#define ABT_VALVES 8u
#define ABT_EDGES 8u
#define ABT_PAYLOAD_MAX 80u

static inline void abt_put_u8(uint8_t *at, uint8_t value) { at[0] = value; }
static inline uint8_t abt_get_u8(const uint8_t *at) { return at[0]; }
static inline void abt_put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}
static inline uint16_t abt_get_u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)(at[1] << 8));
}
static inline void abt_put_u32(uint8_t *at, uint32_t value)
{
    abt_put_u16(at, (uint16_t)value);
    abt_put_u16(at + 2, (uint16_t)(value >> 16));
}
static inline uint32_t abt_get_u32(const uint8_t *at)
{
    return abt_get_u16(at) | ((uint32_t)abt_get_u16(at + 2) << 16);
}

/* What the board may do. */
typedef enum {
    ABT_STATE_BOOT = 0, /* not usable: the limits it was built with contradict each other */
    ABT_STATE_SAFE = 1, /* all valves closed until armed */
    ABT_STATE_ARMED = 2, /* plays plans */
} abt_state;

/* The board's answer to a frame. */
typedef enum {
    ABT_RESULT_OK = 0, /* done */
    ABT_RESULT_REFRESHED = 1, /* this plan is being played already: only the watchdog was fed */
    ABT_RESULT_FOREIGN_SESSION = 2, /* of another session, or before HELLO: say HELLO */
    ABT_RESULT_OUT_OF_RANGE = 3, /* a field is outside the limits of messages.toml */
    ABT_RESULT_NOT_ARMED = 4, /* plans are played in ARMED only */
    ABT_RESULT_CONFIG_FAULT = 5, /* the limits contradict each other; nothing can be armed */
    ABT_RESULT_UNDERVOLTAGE = 6, /* the supply is too low to arm */
    ABT_RESULT_STALE_PLAN = 7, /* older than the plan being played */
    ABT_RESULT_EXPIRED = 8, /* its time to live is over already */
    ABT_RESULT_NO_SUCH_VALVE = 9, /* an on-time for a valve this board does not have */
    ABT_RESULT_ON_TOO_LONG = 10, /* an on-time above the board's max_on_us */
    ABT_RESULT_TTL_TOO_LONG = 11, /* a time to live above the board's max_ttl_us */
    ABT_RESULT_OPPOSING = 12, /* opposing valves open together, or closer than the dead time */
} abt_result;

/* Why the board booted. */
typedef enum {
    ABT_RESET_CAUSE_UNKNOWN = 0, /* the port cannot tell */
    ABT_RESET_CAUSE_POWER_ON = 1, /* power came */
    ABT_RESET_CAUSE_BROWN_OUT = 2, /* the supply dipped */
    ABT_RESET_CAUSE_PIN = 3, /* reset button or debugger */
    ABT_RESET_CAUSE_SOFTWARE = 4, /* asked for by the firmware */
    ABT_RESET_CAUSE_WATCHDOG = 5, /* the independent watchdog: the firmware hung */
} abt_reset_cause;

/* What becomes of bearing air when the board trips. */
typedef enum {
    ABT_BEARING_POLICY_KEEP = 0, /* stays as it is: the vehicle drifts */
    ABT_BEARING_POLICY_DROP = 1, /* off, land_after_us later: the vehicle stands */
} abt_bearing_policy;

/* Reasons for SAFE; latched until the next ARM. */
typedef enum {
    ABT_FAULT_WATCHDOG = 1, /* no accepted plan for watchdog_us */
    ABT_FAULT_UNDERVOLTAGE = 2, /* supply below undervoltage_mv for undervoltage_us */
    ABT_FAULT_CONFIG = 4, /* limits contradict each other */
    ABT_FAULT_INTERLOCK = 8, /* the output stage was asked to open opposing valves */
} abt_fault;

typedef enum {
    ABT_TYPE_HELLO = 1,
    ABT_TYPE_ARM = 2,
    ABT_TYPE_DISARM = 3,
    ABT_TYPE_CMD = 4,
    ABT_TYPE_BEARING = 5,
    ABT_TYPE_PING = 6,
    ABT_TYPE_HELLO_ACK = 129,
    ABT_TYPE_ACK = 130,
    ABT_TYPE_STATUS = 131,
    ABT_TYPE_EDGES = 132,
} abt_type;

/* Start a session: closes everything, disarms, forgets plans and sequence numbers. */
#define ABT_HELLO_SIZE 4u
typedef struct {
    uint32_t host_nonce; /* echoed, so that the host knows its own answer */
} abt_hello;

static inline void abt_hello_pack(const abt_hello *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->host_nonce);
}
static inline void abt_hello_unpack(const uint8_t *from, abt_hello *to)
{
    to->host_nonce = abt_get_u32(from + 0);
}

/* SAFE to ARMED; clears latched faults and starts the watchdog. */
#define ABT_ARM_SIZE 4u
typedef struct {
    uint32_t session; /* from HELLO_ACK */
} abt_arm;

static inline void abt_arm_pack(const abt_arm *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->session);
}
static inline void abt_arm_unpack(const uint8_t *from, abt_arm *to)
{
    to->session = abt_get_u32(from + 0);
}

/* Close everything. Needs no session: anyone may close. */
#define ABT_DISARM_SIZE 0u

/* A complete plan, a pulse per valve; sent again with a new age it only feeds the watchdog. */
#define ABT_CMD_SIZE 80u
typedef struct {
    uint32_t session; /* from HELLO_ACK */
    uint32_t plan; /* number of the plan, rising, wraps */
    uint32_t age_us; /* since the plan began, when this frame was sent [us] */
    uint32_t ttl_us; /* from the plan's beginning to all closed [us] */
    uint32_t on_us[8]; /* open time [us] */
    uint32_t offset_us[8]; /* from the plan's beginning to opening [us] */
} abt_cmd;

static inline void abt_cmd_pack(const abt_cmd *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->session);
    abt_put_u32(to + 4, from->plan);
    abt_put_u32(to + 8, from->age_us);
    abt_put_u32(to + 12, from->ttl_us);
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u32(to + 16 + 4 * i, from->on_us[i]);
    }
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u32(to + 48 + 4 * i, from->offset_us[i]);
    }
}
static inline void abt_cmd_unpack(const uint8_t *from, abt_cmd *to)
{
    to->session = abt_get_u32(from + 0);
    to->plan = abt_get_u32(from + 4);
    to->age_us = abt_get_u32(from + 8);
    to->ttl_us = abt_get_u32(from + 12);
    for (unsigned i = 0; i < 8u; i++) {
        to->on_us[i] = abt_get_u32(from + 16 + 4 * i);
    }
    for (unsigned i = 0; i < 8u; i++) {
        to->offset_us[i] = abt_get_u32(from + 48 + 4 * i);
    }
}
static inline bool abt_cmd_in_range(const abt_cmd *it)
{
    bool good = true;
    good = good && it->age_us <= 10000000u;
    good = good && it->ttl_us >= 1u && it->ttl_us <= 10000000u;
    for (unsigned i = 0; i < 8u; i++) {
        good = good && it->on_us[i] <= 10000000u;
    }
    for (unsigned i = 0; i < 8u; i++) {
        good = good && it->offset_us[i] <= 10000000u;
    }
    return good;
}

/* Bearing air on or off; needs a session, not ARMED: a vehicle floats before it flies. */
#define ABT_BEARING_SIZE 5u
typedef struct {
    uint32_t session; /* from HELLO_ACK */
    uint8_t on; /* 1: on */
} abt_bearing;

static inline void abt_bearing_pack(const abt_bearing *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->session);
    abt_put_u8(to + 4, from->on);
}
static inline void abt_bearing_unpack(const uint8_t *from, abt_bearing *to)
{
    to->session = abt_get_u32(from + 0);
    to->on = abt_get_u8(from + 4);
}
static inline bool abt_bearing_in_range(const abt_bearing *it)
{
    bool good = true;
    good = good && it->on <= 1u;
    return good;
}

/* Ask for an ACK: clocks and state. Feeds nothing. */
#define ABT_PING_SIZE 0u

/* Who the board is. */
#define ABT_HELLO_ACK_SIZE 30u
typedef struct {
    uint32_t host_nonce; /* of the HELLO answered */
    uint32_t session; /* to be quoted from now on */
    uint32_t boot_nonce; /* differs after every boot */
    uint32_t firmware_id; /* first 32 bits of the hash of its sources */
    uint32_t config_hash; /* CRC-32 of the limits record */
    uint8_t reset_cause; /* why it booted */
    uint8_t state;
    uint32_t t1_us; /* t_us of the HELLO, host's clock [us] */
    uint32_t t2_us; /* when its last byte came in, board's clock [us] */
} abt_hello_ack;

static inline void abt_hello_ack_pack(const abt_hello_ack *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->host_nonce);
    abt_put_u32(to + 4, from->session);
    abt_put_u32(to + 8, from->boot_nonce);
    abt_put_u32(to + 12, from->firmware_id);
    abt_put_u32(to + 16, from->config_hash);
    abt_put_u8(to + 20, from->reset_cause);
    abt_put_u8(to + 21, from->state);
    abt_put_u32(to + 22, from->t1_us);
    abt_put_u32(to + 26, from->t2_us);
}
static inline void abt_hello_ack_unpack(const uint8_t *from, abt_hello_ack *to)
{
    to->host_nonce = abt_get_u32(from + 0);
    to->session = abt_get_u32(from + 4);
    to->boot_nonce = abt_get_u32(from + 8);
    to->firmware_id = abt_get_u32(from + 12);
    to->config_hash = abt_get_u32(from + 16);
    to->reset_cause = abt_get_u8(from + 20);
    to->state = abt_get_u8(from + 21);
    to->t1_us = abt_get_u32(from + 22);
    to->t2_us = abt_get_u32(from + 26);
}

/* Answer to one frame; with its own t_us as T3 it gives clock offset and delay. */
#define ABT_ACK_SIZE 15u
typedef struct {
    uint16_t seq; /* of the frame answered */
    uint8_t type; /* of the frame answered */
    uint8_t result;
    uint8_t state; /* after the frame */
    uint8_t faults; /* after the frame */
    uint8_t mask; /* valves open */
    uint32_t t1_us; /* t_us of the frame answered, host's clock [us] */
    uint32_t t2_us; /* when its last byte came in, board's clock [us] */
} abt_ack;

static inline void abt_ack_pack(const abt_ack *from, uint8_t *to)
{
    abt_put_u16(to + 0, from->seq);
    abt_put_u8(to + 2, from->type);
    abt_put_u8(to + 3, from->result);
    abt_put_u8(to + 4, from->state);
    abt_put_u8(to + 5, from->faults);
    abt_put_u8(to + 6, from->mask);
    abt_put_u32(to + 7, from->t1_us);
    abt_put_u32(to + 11, from->t2_us);
}
static inline void abt_ack_unpack(const uint8_t *from, abt_ack *to)
{
    to->seq = abt_get_u16(from + 0);
    to->type = abt_get_u8(from + 2);
    to->result = abt_get_u8(from + 3);
    to->state = abt_get_u8(from + 4);
    to->faults = abt_get_u8(from + 5);
    to->mask = abt_get_u8(from + 6);
    to->t1_us = abt_get_u32(from + 7);
    to->t2_us = abt_get_u32(from + 11);
}

/* Telemetry, every status_period_us from boot on. Counters wrap. */
#define ABT_STATUS_SIZE 80u
typedef struct {
    uint32_t session; /* 0 before the first HELLO */
    uint8_t state;
    uint8_t faults;
    uint8_t mask; /* valves open */
    uint8_t bearing; /* 1: bearing air on */
    uint32_t plan; /* the newest plan accepted */
    uint32_t open_us[8]; /* open time since boot, wraps [us] */
    uint16_t supply_mv; /* valve supply [mV] */
    uint32_t supply_pa; /* behind the regulator [Pa] */
    uint32_t worst_late_us; /* greatest lateness of a run since boot [us] */
    uint16_t bad_length; /* frames too short, too long, or of a wrong length for their type */
    uint16_t bad_crc; /* frames */
    uint16_t bad_version; /* frames */
    uint16_t unknown_type; /* frames */
    uint16_t foreign; /* frames of another session */
    uint16_t replayed; /* frames with a sequence number already used */
    uint16_t refused; /* frames answered by neither OK nor REFRESHED */
    uint16_t watchdog_trips;
    uint16_t unplayed; /* pulses not played: too short, or too short when the valve was free */
    uint16_t cut_max_on; /* openings ended by max_on_us */
    uint16_t cut_duty; /* openings ended by the duty budget */
    uint16_t lost_acks; /* answers never sent: more frames than the line back carries */
    uint16_t lost_edges; /* edges not reported */
} abt_status;

static inline void abt_status_pack(const abt_status *from, uint8_t *to)
{
    abt_put_u32(to + 0, from->session);
    abt_put_u8(to + 4, from->state);
    abt_put_u8(to + 5, from->faults);
    abt_put_u8(to + 6, from->mask);
    abt_put_u8(to + 7, from->bearing);
    abt_put_u32(to + 8, from->plan);
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u32(to + 12 + 4 * i, from->open_us[i]);
    }
    abt_put_u16(to + 44, from->supply_mv);
    abt_put_u32(to + 46, from->supply_pa);
    abt_put_u32(to + 50, from->worst_late_us);
    abt_put_u16(to + 54, from->bad_length);
    abt_put_u16(to + 56, from->bad_crc);
    abt_put_u16(to + 58, from->bad_version);
    abt_put_u16(to + 60, from->unknown_type);
    abt_put_u16(to + 62, from->foreign);
    abt_put_u16(to + 64, from->replayed);
    abt_put_u16(to + 66, from->refused);
    abt_put_u16(to + 68, from->watchdog_trips);
    abt_put_u16(to + 70, from->unplayed);
    abt_put_u16(to + 72, from->cut_max_on);
    abt_put_u16(to + 74, from->cut_duty);
    abt_put_u16(to + 76, from->lost_acks);
    abt_put_u16(to + 78, from->lost_edges);
}
static inline void abt_status_unpack(const uint8_t *from, abt_status *to)
{
    to->session = abt_get_u32(from + 0);
    to->state = abt_get_u8(from + 4);
    to->faults = abt_get_u8(from + 5);
    to->mask = abt_get_u8(from + 6);
    to->bearing = abt_get_u8(from + 7);
    to->plan = abt_get_u32(from + 8);
    for (unsigned i = 0; i < 8u; i++) {
        to->open_us[i] = abt_get_u32(from + 12 + 4 * i);
    }
    to->supply_mv = abt_get_u16(from + 44);
    to->supply_pa = abt_get_u32(from + 46);
    to->worst_late_us = abt_get_u32(from + 50);
    to->bad_length = abt_get_u16(from + 54);
    to->bad_crc = abt_get_u16(from + 56);
    to->bad_version = abt_get_u16(from + 58);
    to->unknown_type = abt_get_u16(from + 60);
    to->foreign = abt_get_u16(from + 62);
    to->replayed = abt_get_u16(from + 64);
    to->refused = abt_get_u16(from + 66);
    to->watchdog_trips = abt_get_u16(from + 68);
    to->unplayed = abt_get_u16(from + 70);
    to->cut_max_on = abt_get_u16(from + 72);
    to->cut_duty = abt_get_u16(from + 74);
    to->lost_acks = abt_get_u16(from + 76);
    to->lost_edges = abt_get_u16(from + 78);
}

/* Valve outputs as they were driven, oldest first. */
#define ABT_EDGES_SIZE 41u
typedef struct {
    uint8_t count; /* entries used */
    uint32_t at_us[8]; /* board's clock [us] */
    uint8_t mask[8]; /* valves open from then on */
} abt_edges;

static inline void abt_edges_pack(const abt_edges *from, uint8_t *to)
{
    abt_put_u8(to + 0, from->count);
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u32(to + 1 + 4 * i, from->at_us[i]);
    }
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u8(to + 33 + 1 * i, from->mask[i]);
    }
}
static inline void abt_edges_unpack(const uint8_t *from, abt_edges *to)
{
    to->count = abt_get_u8(from + 0);
    for (unsigned i = 0; i < 8u; i++) {
        to->at_us[i] = abt_get_u32(from + 1 + 4 * i);
    }
    for (unsigned i = 0; i < 8u; i++) {
        to->mask[i] = abt_get_u8(from + 33 + 1 * i);
    }
}
static inline bool abt_edges_in_range(const abt_edges *it)
{
    bool good = true;
    good = good && it->count <= 8u;
    return good;
}

/* Valve map and limits. */
#define ABT_CONFIG_SIZE 60u
typedef struct {
    uint8_t valve_count;
    uint8_t opposing[8]; /* per valve, mask of the valves that push against it */
    uint32_t jets; /* CRC-32 of where the jets are and which way they push; only hashed */
    uint8_t bearing_after_trip;
    uint32_t land_after_us; /* from a trip to bearing air off; ARM and BEARING cancel it [us] */
    uint32_t min_on_us; /* shorter pulses are not played [us] */
    uint32_t min_off_us; /* a valve stays closed at least so long [us] */
    uint32_t dead_us; /* between a valve's closing and its opposite's opening [us] */
    uint32_t max_on_us; /* per opening [us] */
    uint32_t duty_window_us; /* multiple of 16 [us] */
    uint32_t duty_budget_us; /* open time of a valve in any duty window [us] */
    uint32_t max_ttl_us; /* of a plan [us] */
    uint32_t watchdog_us; /* without an accepted plan [us] */
    uint16_t undervoltage_mv; /* 0: the board has no voltmeter [mV] */
    uint32_t undervoltage_us; /* so long below before it trips [us] */
    uint32_t status_period_us; /* [us] */
} abt_config;

static inline void abt_config_pack(const abt_config *from, uint8_t *to)
{
    abt_put_u8(to + 0, from->valve_count);
    for (unsigned i = 0; i < 8u; i++) {
        abt_put_u8(to + 1 + 1 * i, from->opposing[i]);
    }
    abt_put_u32(to + 9, from->jets);
    abt_put_u8(to + 13, from->bearing_after_trip);
    abt_put_u32(to + 14, from->land_after_us);
    abt_put_u32(to + 18, from->min_on_us);
    abt_put_u32(to + 22, from->min_off_us);
    abt_put_u32(to + 26, from->dead_us);
    abt_put_u32(to + 30, from->max_on_us);
    abt_put_u32(to + 34, from->duty_window_us);
    abt_put_u32(to + 38, from->duty_budget_us);
    abt_put_u32(to + 42, from->max_ttl_us);
    abt_put_u32(to + 46, from->watchdog_us);
    abt_put_u16(to + 50, from->undervoltage_mv);
    abt_put_u32(to + 52, from->undervoltage_us);
    abt_put_u32(to + 56, from->status_period_us);
}
static inline void abt_config_unpack(const uint8_t *from, abt_config *to)
{
    to->valve_count = abt_get_u8(from + 0);
    for (unsigned i = 0; i < 8u; i++) {
        to->opposing[i] = abt_get_u8(from + 1 + 1 * i);
    }
    to->jets = abt_get_u32(from + 9);
    to->bearing_after_trip = abt_get_u8(from + 13);
    to->land_after_us = abt_get_u32(from + 14);
    to->min_on_us = abt_get_u32(from + 18);
    to->min_off_us = abt_get_u32(from + 22);
    to->dead_us = abt_get_u32(from + 26);
    to->max_on_us = abt_get_u32(from + 30);
    to->duty_window_us = abt_get_u32(from + 34);
    to->duty_budget_us = abt_get_u32(from + 38);
    to->max_ttl_us = abt_get_u32(from + 42);
    to->watchdog_us = abt_get_u32(from + 46);
    to->undervoltage_mv = abt_get_u16(from + 50);
    to->undervoltage_us = abt_get_u32(from + 52);
    to->status_period_us = abt_get_u32(from + 56);
}
static inline bool abt_config_in_range(const abt_config *it)
{
    bool good = true;
    good = good && it->valve_count >= 1u && it->valve_count <= 8u;
    good = good && it->bearing_after_trip <= 1u;
    good = good && it->land_after_us <= 60000000u;
    good = good && it->min_on_us <= 1000000u;
    good = good && it->min_off_us <= 1000000u;
    good = good && it->dead_us <= 1000000u;
    good = good && it->max_on_us >= 1u && it->max_on_us <= 10000000u;
    good = good && it->duty_window_us >= 16000u && it->duty_window_us <= 160000000u;
    good = good && it->duty_budget_us >= 1u && it->duty_budget_us <= 160000000u;
    good = good && it->max_ttl_us >= 1u && it->max_ttl_us <= 10000000u;
    good = good && it->watchdog_us >= 1000u && it->watchdog_us <= 2000000u;
    good = good && it->undervoltage_mv <= 60000u;
    good = good && it->undervoltage_us <= 1000000u;
    good = good && it->status_period_us >= 1000u && it->status_period_us <= 10000000u;
    return good;
}

#define ABT_NO_SUCH_TYPE 255u
/* Payload length of what a host may send. */
static inline uint8_t abt_payload_size(uint8_t type)
{
    switch (type) {
    case ABT_TYPE_HELLO: return ABT_HELLO_SIZE;
    case ABT_TYPE_ARM: return ABT_ARM_SIZE;
    case ABT_TYPE_DISARM: return ABT_DISARM_SIZE;
    case ABT_TYPE_CMD: return ABT_CMD_SIZE;
    case ABT_TYPE_BEARING: return ABT_BEARING_SIZE;
    case ABT_TYPE_PING: return ABT_PING_SIZE;
    default: return ABT_NO_SUCH_TYPE;
    }
}

#endif
