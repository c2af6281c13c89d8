#include "abt_firmware.h"

static void enter(abt_firmware *firmware)
{
    firmware->port.enter(firmware->port.context);
}

static void leave(abt_firmware *firmware)
{
    firmware->port.leave(firmware->port.context);
}

uint32_t abt_config_hash(const abt_config *config)
{
    uint8_t record[ABT_CONFIG_SIZE];
    abt_config_pack(config, record);
    return abt_crc32(record, ABT_CONFIG_SIZE);
}

void abt_init(abt_firmware *firmware, const abt_config *config, const abt_identity *identity,
              abt_port port, uint32_t now_us)
{
    const bool valid = abt_config_valid(config);
    *firmware = (abt_firmware){.config = *config, .identity = *identity, .port = port};
    firmware->control.state = valid ? ABT_STATE_SAFE : ABT_STATE_BOOT;
    firmware->control.faults = valid ? 0 : ABT_FAULT_CONFIG;
    firmware->control.wake_us = now_us;
    firmware->outbox.status_us = now_us;
    abt_valves_init(&firmware->control.valves, &firmware->config, now_us);
}

/* ---- Interrupt side ----------------------------------------------------------------------- */

static void trip(abt_firmware *firmware, abt_fault fault)
{
    abt_control *control = &firmware->control;
    control->state = ABT_STATE_SAFE;
    control->faults = (uint8_t)(control->faults | fault);
    control->plan_waiting = false;
    if (firmware->config.bearing_after_trip == ABT_BEARING_POLICY_DROP) {
        control->bearing = false;
    }
}

static void judge_supply(abt_firmware *firmware, uint32_t now_us, abt_sensors sensors)
{
    abt_control *control = &firmware->control;
    const bool low = sensors.supply_mv < firmware->config.undervoltage_mv;
    if (low && !control->supply_low) {
        control->low_since_us = now_us;
    }
    control->supply_low = low;
    control->sensors = sensors;
    if (low && control->state == ABT_STATE_ARMED &&
        now_us - control->low_since_us >= firmware->config.undervoltage_us) {
        trip(firmware, ABT_FAULT_UNDERVOLTAGE);
    }
}

static void judge_watchdog(abt_firmware *firmware, uint32_t now_us)
{
    abt_control *control = &firmware->control;
    if (control->state == ABT_STATE_ARMED &&
        abt_reached(now_us, control->fed_us + firmware->config.watchdog_us)) {
        trip(firmware, ABT_FAULT_WATCHDOG);
        control->watchdog_trips++;
    }
}

static void move_valves(abt_firmware *firmware, uint32_t now_us)
{
    abt_control *control = &firmware->control;
    if (control->state != ABT_STATE_ARMED || control->close_waiting) {
        abt_valves_close(&control->valves, now_us);
    }
    control->close_waiting = false;
    if (control->state != ABT_STATE_ARMED) {
        return;
    }
    if (control->plan_waiting) {
        control->plan_waiting = false;
        abt_valves_take(&control->valves, &control->plan, now_us);
    }
    abt_valves_run(&control->valves, now_us);
}

static void note_edge(abt_control *control, uint32_t now_us, uint8_t mask)
{
    if (control->edge_count == ABT_EDGE_RING) {
        control->lost_edges++;
        return;
    }
    const unsigned at = (control->edge_first + (unsigned)control->edge_count) % ABT_EDGE_RING;
    control->edge_us[at] = now_us;
    control->edge_mask[at] = mask;
    control->edge_count++;
}

static void drive(abt_firmware *firmware, uint32_t now_us)
{
    abt_control *control = &firmware->control;
    const uint8_t before = control->output.mask;
    const uint8_t wanted = abt_valves_mask(&control->valves);
    if (!abt_output_step(&control->output, &firmware->config, wanted, now_us)) {
        trip(firmware, ABT_FAULT_INTERLOCK);
        abt_valves_close(&control->valves, now_us);
    }
    if (control->output.mask != before) {
        note_edge(control, now_us, control->output.mask);
    }
}

static uint32_t next_wake_us(const abt_firmware *firmware, uint32_t now_us)
{
    const abt_control *control = &firmware->control;
    uint32_t wake_us = now_us + ABT_HOUSEKEEPING_US;
    const uint32_t bite_us = control->fed_us + firmware->config.watchdog_us;
    const uint32_t low_us = control->low_since_us + firmware->config.undervoltage_us;
    if (control->state != ABT_STATE_ARMED) {
        return wake_us;
    }
    if (abt_reached(wake_us, bite_us)) {
        wake_us = bite_us;
    }
    if (control->supply_low && abt_reached(wake_us, low_us)) {
        wake_us = low_us;
    }
    return abt_valves_wake(&control->valves, wake_us);
}

static void note_lateness(abt_control *control, uint32_t now_us)
{
    if (abt_reached(now_us, control->wake_us) &&
        now_us - control->wake_us > control->worst_late_us) {
        control->worst_late_us = now_us - control->wake_us;
    }
}

abt_outputs abt_run(abt_firmware *firmware, uint32_t now_us, abt_sensors sensors)
{
    abt_control *control = &firmware->control;
    if (control->state != ABT_STATE_BOOT) {
        note_lateness(control, now_us);
        judge_supply(firmware, now_us, sensors);
        judge_watchdog(firmware, now_us);
        move_valves(firmware, now_us);
        drive(firmware, now_us);
    }
    control->wake_us = next_wake_us(firmware, now_us);
    return (abt_outputs){control->output.mask, control->bearing, control->wake_us};
}

/* ---- What the host asks for; inside the critical section ---------------------------------- */

static abt_result arm(abt_firmware *firmware, uint32_t now_us)
{
    abt_control *control = &firmware->control;
    if (control->state == ABT_STATE_BOOT) {
        return ABT_RESULT_CONFIG_FAULT;
    }
    if (control->supply_low) {
        return ABT_RESULT_UNDERVOLTAGE;
    }
    if (control->state == ABT_STATE_SAFE) {
        control->state = ABT_STATE_ARMED;
        control->faults = 0;
        control->fed_us = now_us;
    }
    return ABT_RESULT_OK;
}

static void disarm(abt_control *control)
{
    if (control->state == ABT_STATE_ARMED) {
        control->state = ABT_STATE_SAFE;
    }
    control->plan_waiting = false;
    control->close_waiting = true; /* ARM may follow before the next run */
}

static abt_result offer(abt_control *control, const abt_cmd *cmd, uint32_t now_us)
{
    if (control->state != ABT_STATE_ARMED) {
        return ABT_RESULT_NOT_ARMED;
    }
    if (control->plan_known && !abt_reached(cmd->plan, control->plan_id)) {
        return ABT_RESULT_STALE_PLAN;
    }
    control->fed_us = now_us;
    if (control->plan_known && cmd->plan == control->plan_id) {
        return ABT_RESULT_REFRESHED;
    }
    control->plan_known = true;
    control->plan_id = cmd->plan;
    control->plan_waiting = true;
    control->plan.received_us = now_us;
    control->plan.start_us = now_us - cmd->age_us;
    control->plan.end_us = control->plan.start_us + cmd->ttl_us;
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        control->plan.on_us[i] = cmd->on_us[i];
        control->plan.offset_us[i] = cmd->offset_us[i];
    }
    return ABT_RESULT_OK;
}

/* ---- Main-loop side: frames in ------------------------------------------------------------ */

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
    enter(firmware);
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
    leave(firmware);
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
    enter(firmware);
    disarm(&firmware->control);
    firmware->control.plan_known = false;
    const abt_state state = firmware->control.state;
    leave(firmware);
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
    enter(firmware);
    disarm(&firmware->control);
    leave(firmware);
    answer(firmware, frame, ABT_RESULT_OK, now_us);
}

static abt_result on_arm(abt_firmware *firmware, uint32_t now_us)
{
    enter(firmware);
    const abt_result result = arm(firmware, now_us);
    leave(firmware);
    return result;
}

static abt_result on_cmd(abt_firmware *firmware, const abt_frame *frame, uint32_t now_us)
{
    abt_cmd cmd;
    abt_cmd_unpack(frame->payload, &cmd);
    abt_result result = abt_cmd_check(&firmware->config, &cmd);
    if (result == ABT_RESULT_OK) {
        enter(firmware);
        result = offer(&firmware->control, &cmd, now_us);
        leave(firmware);
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
    enter(firmware);
    firmware->control.bearing = bearing.on == 1;
    leave(firmware);
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

/* ---- Main-loop side: frames out ----------------------------------------------------------- */

static uint32_t status_period_us(const abt_firmware *firmware)
{
    const bool usable = firmware->control.state != ABT_STATE_BOOT;
    return usable ? firmware->config.status_period_us : ABT_BOOT_STATUS_US;
}

static size_t send(abt_firmware *firmware, uint32_t now_us, abt_frame *frame, abt_type type,
                   uint8_t payload_size, uint8_t *out)
{
    frame->type = (uint8_t)type;
    frame->seq = firmware->outbox.seq++;
    frame->t_us = now_us;
    frame->payload_size = payload_size;
    return abt_encode(frame, out);
}

static void take_ack(abt_outbox *outbox, abt_frame *frame)
{
    abt_ack_pack(&outbox->ack[outbox->ack_first], frame->payload);
    outbox->ack_first = (uint8_t)((outbox->ack_first + 1u) % ABT_ACKS);
    outbox->ack_count--;
}

static bool take_edges(abt_firmware *firmware, abt_frame *frame)
{
    abt_control *control = &firmware->control;
    abt_edges edges = {0};
    enter(firmware);
    while (control->edge_count > 0 && edges.count < ABT_EDGES) {
        edges.at_us[edges.count] = control->edge_us[control->edge_first];
        edges.mask[edges.count] = control->edge_mask[control->edge_first];
        edges.count++;
        control->edge_first = (uint8_t)((control->edge_first + 1u) % ABT_EDGE_RING);
        control->edge_count--;
    }
    leave(firmware);
    abt_edges_pack(&edges, frame->payload);
    return edges.count > 0;
}

static void take_status(abt_firmware *firmware, abt_frame *frame)
{
    const abt_control *control = &firmware->control;
    abt_status status = firmware->counters;
    status.session = firmware->session.session;
    enter(firmware);
    status.state = (uint8_t)control->state;
    status.faults = control->faults;
    status.mask = control->output.mask;
    status.bearing = control->bearing;
    status.plan = control->plan_id;
    for (unsigned i = 0; i < ABT_VALVES; i++) {
        status.open_us[i] = control->valves.valve[i].open_total_us;
    }
    status.supply_mv = control->sensors.supply_mv;
    status.supply_pa = control->sensors.supply_pa;
    status.worst_late_us = control->worst_late_us;
    status.watchdog_trips = control->watchdog_trips;
    status.unplayed = control->valves.unplayed;
    status.cut_max_on = control->valves.cut_max_on;
    status.cut_duty = control->valves.cut_duty;
    status.lost_edges = control->lost_edges;
    leave(firmware);
    abt_status_pack(&status, frame->payload);
}

size_t abt_transmit(abt_firmware *firmware, uint32_t now_us, uint8_t *out)
{
    abt_outbox *outbox = &firmware->outbox;
    abt_frame frame;
    if (outbox->hello_waiting) {
        outbox->hello_waiting = false;
        abt_hello_ack_pack(&outbox->hello, frame.payload);
        return send(firmware, now_us, &frame, ABT_TYPE_HELLO_ACK, ABT_HELLO_ACK_SIZE, out);
    }
    if (outbox->ack_count > 0) {
        take_ack(outbox, &frame);
        return send(firmware, now_us, &frame, ABT_TYPE_ACK, ABT_ACK_SIZE, out);
    }
    if (take_edges(firmware, &frame)) {
        return send(firmware, now_us, &frame, ABT_TYPE_EDGES, ABT_EDGES_SIZE, out);
    }
    if (abt_reached(now_us, outbox->status_us)) {
        outbox->status_us = now_us + status_period_us(firmware);
        take_status(firmware, &frame);
        return send(firmware, now_us, &frame, ABT_TYPE_STATUS, ABT_STATUS_SIZE, out);
    }
    return 0;
}
