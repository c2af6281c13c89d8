/* The valve driver board as a port sees it: frames in (abt_session.c), what the outputs are
 * (abt_control.c), frames out (abt_telemetry.c).
 *
 * A port calls four functions, each with its clock in microseconds:
 *
 *   main loop    abt_receive   bytes from the host; if it returns true, run at once
 *                abt_transmit  the next frame for the host
 *   interrupt    abt_run       at the instant it asked for last time, and when told to
 *   before both  abt_init
 *
 * abt_run is the only one that decides what the outputs are. It may interrupt the other two
 * anywhere; they reach what they share with it only between port.enter and port.leave.
 */
#ifndef ABT_FIRMWARE_H
#define ABT_FIRMWARE_H

#include "abt_control.h"
#include "abt_frame.h"

#define ABT_BOOT_STATUS_US 100000u /* period of STATUS while the limits are unusable */
#define ABT_ACKS 8u /* answers waiting for the line */

/* How the port keeps abt_run away. */
typedef struct {
    void (*enter)(void *context);
    void (*leave)(void *context);
    void *context;
} abt_port;

typedef struct {
    uint32_t firmware_id;
    uint32_t boot_nonce; /* differs after every boot */
    abt_reset_cause reset_cause;
} abt_identity;

typedef struct {
    uint32_t session;
    uint32_t hellos;
    bool greeted; /* `session` is valid */
    bool seq_known;
    uint16_t last_seq; /* of the newest frame of the session */
} abt_session;

/* Frames on their way to the host. */
typedef struct {
    uint16_t seq;
    bool hello_waiting;
    abt_hello_ack hello;
    abt_ack ack[ABT_ACKS];
    uint8_t ack_first;
    uint8_t ack_count;
    uint32_t status_us; /* when the next STATUS is due */
} abt_outbox;

typedef struct {
    abt_config config;
    abt_identity identity;
    abt_port port;
    abt_control control;
    abt_decoder decoder;
    abt_session session;
    abt_outbox outbox;
    abt_status counters; /* only its counters of frames are used */
} abt_firmware;

/* All closed, and SAFE if the limits agree with each other, else BOOT for good. */
void abt_init(abt_firmware *firmware, const abt_config *config, const abt_identity *identity,
              abt_port port, uint32_t now_us);

/* Bytes from the host, `now_us` being when the last of them came in; true: run at once. */
bool abt_receive(abt_firmware *firmware, uint32_t now_us, const uint8_t *bytes, size_t count);

/* Let time pass. */
abt_outputs abt_run(abt_firmware *firmware, uint32_t now_us, abt_sensors sensors);

/* The next frame for the host into `out`, ABT_FRAME_MAX long; its length, 0 for none. */
size_t abt_transmit(abt_firmware *firmware, uint32_t now_us, uint8_t *out);

/* For the core itself. */
static inline void abt_enter(abt_firmware *firmware)
{
    firmware->port.enter(firmware->port.context);
}

static inline void abt_leave(abt_firmware *firmware)
{
    firmware->port.leave(firmware->port.context);
}

#endif
