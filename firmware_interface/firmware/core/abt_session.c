#include "abt_firmware.h"

static void answer(abt_firmware *firmware, const abt_frame *frame, abt_result result,
                   uint32_t now_us)
{
    abt_outbox *outbox = &firmware->outbox;
    const abt_control *control = &firmware->control;
    if (result != ABT_RESULT_OK && result != ABT_RESULT_REFRESHED) {
        firmware->counters.refused++;
    }
    if (outbox->ack_count == ABT_ACKS) {
        firmware->counters.lost_acks++;
        return;
    }
    abt_ack *ack = &outbox->ack[(outbox->ack_first + (unsigned)outbox->ack_count) % ABT_ACKS];
    outbox->ack_count++;
    abt_enter(firmware);
    *ack = (abt_ack){
        .seq = frame->seq,
        .type = frame->type,
        .result = (uint8_t)result,
        .state = (uint8_t)control->state,
        .faults = control->faults,
        .mask = control->output.mask,
        .t1_us = frame->t_us,
        .t2_us = now_us,
    };
    abt_leave(firmware);
}

static void on_hello(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    abt_session *session = &firmware->session;
    abt_hello hello;
    abt_hello_unpack(frame->payload, &hello);
    session->hellos++;
    session->session = firmware->identity.boot_nonce + session->hellos * 0x9e3779b9u;
    session->greeted = true;
    session->seq_known = false;
    abt_enter(firmware);
    abt_control_disarm(&firmware->control);
    firmware->control.plan_known = false;
    const abt_state state = firmware->control.state;
    abt_leave(firmware);
    firmware->outbox.ack_count = 0; /* answers to a session that is over */
    firmware->outbox.hello_waiting = true;
    firmware->outbox.hello = (abt_hello_ack){
        .host_nonce = hello.host_nonce,
        .session = session->session,
        .boot_nonce = firmware->identity.boot_nonce,
        .firmware_id = firmware->identity.firmware_id,
        .config_hash = abt_config_hash(&firmware->config),
        .reset_cause = (uint8_t)firmware->identity.reset_cause,
        .state = (uint8_t)state,
        .t1_us = frame->t_us,
        .t2_us = now_us,
    };
}

static void on_disarm(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    abt_enter(firmware);
    abt_control_disarm(&firmware->control);
    abt_leave(firmware);
    answer(firmware, frame, ABT_RESULT_OK, now_us);
}

static abt_result on_arm(abt_firmware *firmware, uint32_t now_us)
{
    abt_enter(firmware);
    const abt_result result = abt_control_arm(&firmware->control, now_us);
    abt_leave(firmware);
    return result;
}

static abt_result on_cmd(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    abt_cmd cmd;
    abt_cmd_unpack(frame->payload, &cmd);
    abt_result result = abt_cmd_check(&firmware->config, &cmd);
    if (result == ABT_RESULT_OK) {
        abt_enter(firmware);
        result = abt_control_offer(&firmware->control, &cmd, now_us);
        abt_leave(firmware);
    }
    return result;
}

static abt_result on_bearing(abt_firmware *firmware, const abt_frame *frame)
{
    abt_bearing bearing;
    abt_bearing_unpack(frame->payload, &bearing);
    if (!abt_bearing_in_range(&bearing)) {
        return ABT_RESULT_OUT_OF_RANGE;
    }
    abt_enter(firmware);
    abt_control_bearing(&firmware->control, bearing.on == 1);
    abt_leave(firmware);
    return ABT_RESULT_OK;
}

/* Frames that need a session: its number comes first in the payload. */
static void on_session_frame(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    abt_session *session = &firmware->session;
    if (!session->greeted || abt_get_u32(frame->payload) != session->session) {
        firmware->counters.foreign++;
        answer(firmware, frame, ABT_RESULT_FOREIGN_SESSION, now_us);
        return;
    }
    const uint16_t ahead = (uint16_t)(frame->seq - session->last_seq);
    if (session->seq_known && (ahead == 0 || ahead >= 0x8000u)) {
        firmware->counters.replayed++;
        return;
    }
    session->seq_known = true;
    session->last_seq = frame->seq;
    abt_result result;
    switch (frame->type) {
    case ABT_TYPE_ARM: result = on_arm(firmware, now_us); break;
    case ABT_TYPE_CMD: result = on_cmd(firmware, frame, now_us); break;
    default: result = on_bearing(firmware, frame); break;
    }
    answer(firmware, frame, result, now_us);
}

static void on_frame(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    const uint8_t size = abt_payload_size(frame->type);
    if (size == ABT_NO_SUCH_TYPE) {
        firmware->counters.unknown_type++;
    } else if (size != frame->payload_size) {
        firmware->counters.bad_length++;
    } else if (frame->type == ABT_TYPE_HELLO) {
        on_hello(firmware, frame, now_us);
    } else if (frame->type == ABT_TYPE_DISARM) {
        on_disarm(firmware, frame, now_us);
    } else if (frame->type == ABT_TYPE_PING) {
        answer(firmware, frame, ABT_RESULT_OK, now_us);
    } else {
        on_session_frame(firmware, frame, now_us);
    }
}

bool abt_receive(abt_firmware *firmware, uint32_t now_us, const uint8_t *bytes, size_t count)
{
    bool heard = false;
    for (size_t i = 0; i < count; i++) {
        abt_frame frame;
        switch (abt_decode(&firmware->decoder, bytes[i], &frame)) {
        case ABT_FRAME_NONE: break;
        case ABT_FRAME_BAD_LENGTH: firmware->counters.bad_length++; break;
        case ABT_FRAME_BAD_CRC: firmware->counters.bad_crc++; break;
        case ABT_FRAME_BAD_VERSION: firmware->counters.bad_version++; break;
        case ABT_FRAME_GOOD:
            on_frame(firmware, &frame, now_us);
            heard = true;
            break;
        }
    }
    return heard;
}
