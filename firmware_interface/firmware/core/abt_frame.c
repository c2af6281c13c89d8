#include "abt_frame.h"

#define DELIMITER 0u

/* CRC-32 of the sixteen nibbles: 64 bytes of flash instead of the usual 1 KiB. */
static const uint32_t CRC_OF_NIBBLE[16] = {
    0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u,
    0x4db26158u, 0x5005713cu, 0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
    0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
};

uint32_t abt_crc32(const uint8_t *bytes, size_t count)
{
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < count; i++) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ CRC_OF_NIBBLE[crc & 15u];
        crc = (crc >> 4) ^ CRC_OF_NIBBLE[crc & 15u];
    }
    return ~crc;
}

/* Undo COBS; returns the number of bytes written to `raw`, 0 if `coded` is not COBS. */
static size_t unstuff(const uint8_t *coded, size_t count, uint8_t *raw)
{
    size_t read = 0, written = 0;
    while (read < count) {
        const size_t block = coded[read++];
        if (block - 1u > count - read) {
            return 0; /* points beyond the end */
        }
        for (size_t i = 1; i < block; i++) {
            raw[written++] = coded[read++];
        }
        if (read < count) {
            raw[written++] = 0; /* not after the last block */
        }
    }
    return written;
}

/* COBS and delimiter; returns the length. `count` is below 254. */
static size_t stuff(const uint8_t *raw, size_t count, uint8_t *out)
{
    size_t block_at = 0, written = 1;
    for (size_t i = 0; i < count; i++) {
        if (raw[i] == 0) {
            out[block_at] = (uint8_t)(written - block_at);
            block_at = written++;
        } else {
            out[written++] = raw[i];
        }
    }
    out[block_at] = (uint8_t)(written - block_at);
    out[written++] = DELIMITER;
    return written;
}

static abt_frame_result judge(const uint8_t *coded, size_t count, abt_frame *frame)
{
    uint8_t raw[ABT_CODED_MAX];
    if (count > ABT_CODED_MAX) {
        return ABT_FRAME_BAD_LENGTH;
    }
    const size_t size = unstuff(coded, count, raw);
    if (size < ABT_RAW_MIN) {
        return ABT_FRAME_BAD_LENGTH;
    }
    const size_t checked = size - ABT_CRC_SIZE;
    if (abt_crc32(raw, checked) != abt_get_u32(raw + checked)) {
        return ABT_FRAME_BAD_CRC;
    }
    if (raw[0] != ABT_VERSION) {
        return ABT_FRAME_BAD_VERSION;
    }
    frame->type = raw[1];
    frame->seq = abt_get_u16(raw + 2);
    frame->t_us = abt_get_u32(raw + 4);
    frame->payload_size = (uint8_t)(checked - ABT_HEADER_SIZE);
    for (size_t i = 0; i < frame->payload_size; i++) {
        frame->payload[i] = raw[ABT_HEADER_SIZE + i];
    }
    return ABT_FRAME_GOOD;
}

abt_frame_result abt_decode(abt_decoder *decoder, uint8_t byte, abt_frame *frame)
{
    if (byte != DELIMITER) {
        if (decoder->size < ABT_CODED_MAX) {
            decoder->coded[decoder->size] = byte;
        }
        if (decoder->size <= ABT_CODED_MAX) {
            decoder->size++;
        }
        return ABT_FRAME_NONE;
    }
    const uint8_t size = decoder->size;
    decoder->size = 0;
    return size == 0 ? ABT_FRAME_NONE : judge(decoder->coded, size, frame);
}

size_t abt_encode(const abt_frame *frame, uint8_t *out)
{
    uint8_t raw[ABT_RAW_MAX];
    raw[0] = ABT_VERSION;
    raw[1] = frame->type;
    abt_put_u16(raw + 2, frame->seq);
    abt_put_u32(raw + 4, frame->t_us);
    for (size_t i = 0; i < frame->payload_size; i++) {
        raw[ABT_HEADER_SIZE + i] = frame->payload[i];
    }
    const size_t checked = ABT_HEADER_SIZE + frame->payload_size;
    abt_put_u32(raw + checked, abt_crc32(raw, checked));
    return stuff(raw, checked + ABT_CRC_SIZE, out);
}
