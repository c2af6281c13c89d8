#include "abt_firmware.h"

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
    abt_enter(firmware);
    while (control->edge_count > 0 && edges.count < ABT_EDGES) {
        edges.at_us[edges.count] = control->edge_us[control->edge_first];
        edges.mask[edges.count] = control->edge_mask[control->edge_first];
        edges.count++;
        control->edge_first = (uint8_t)((control->edge_first + 1u) % ABT_EDGE_RING);
        control->edge_count--;
    }
    abt_leave(firmware);
    abt_edges_pack(&edges, frame->payload);
    return edges.count > 0;
}

static void take_status(abt_firmware *firmware, abt_frame *frame)
{
    const abt_control *control = &firmware->control;
    abt_status status = firmware->counters;
    status.session = firmware->session.session;
    abt_enter(firmware);
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
    abt_leave(firmware);
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
