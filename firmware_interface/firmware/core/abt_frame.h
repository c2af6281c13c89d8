/* Frames on the line: COBS(version | type | seq | t_us | payload | crc32) 0x00, little endian.
 *
 * COBS: S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on
 * Networking 7(2), 1999. CRC-32 is that of IEEE 802.3, as in zlib.
 */
#ifndef ABT_FRAME_H
#define ABT_FRAME_H

#include <stddef.h>

#include "abt_messages.h"

#define ABT_HEADER_SIZE 8u
#define ABT_CRC_SIZE 4u
#define ABT_RAW_MIN (ABT_HEADER_SIZE + ABT_CRC_SIZE)
#define ABT_RAW_MAX (ABT_RAW_MIN + ABT_PAYLOAD_MAX)
#define ABT_CODED_MAX (ABT_RAW_MAX + 1u) /* below 255 bytes COBS costs one byte */
#define ABT_FRAME_MAX (ABT_CODED_MAX + 1u) /* with the delimiter */

typedef struct {
    uint8_t type;
    uint16_t seq;
    uint32_t t_us; /* sender's clock */
    uint8_t payload_size;
    uint8_t payload[ABT_PAYLOAD_MAX];
} abt_frame;

typedef enum {
    ABT_FRAME_NONE, /* no delimiter yet, or nothing between two of them */
    ABT_FRAME_GOOD,
    ABT_FRAME_BAD_LENGTH, /* too short, too long, or not COBS */
    ABT_FRAME_BAD_CRC,
    ABT_FRAME_BAD_VERSION,
} abt_frame_result;

/* Bytes since the last delimiter. All zero is the initial state. */
typedef struct {
    uint8_t size; /* ABT_CODED_MAX + 1 once too many came */
    uint8_t coded[ABT_CODED_MAX];
} abt_decoder;

uint32_t abt_crc32(const uint8_t *bytes, size_t count);

/* Take one byte; at a delimiter judge what came before it and fill `frame` if that is good. */
abt_frame_result abt_decode(abt_decoder *decoder, uint8_t byte, abt_frame *frame);

/* Write a frame with its delimiter to `out`, ABT_FRAME_MAX long at least; returns its length. */
size_t abt_encode(const abt_frame *frame, uint8_t *out);

#endif
