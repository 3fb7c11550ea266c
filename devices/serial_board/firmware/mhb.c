#include "mhb.h"

#include <string.h>

enum { HELLO = 0x01, FORCE = 0x02, ABOUT = 0x81, STATE = 0x82 };

/* Bytes are put together one by one: a board may be of either endianness and may refuse unaligned words. */
static uint16_t u16(const uint8_t *at) { return (uint16_t)(at[0] | (uint16_t)at[1] << 8); }

static uint32_t u32(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static float f32(const uint8_t *at) {
    uint32_t bits = u32(at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint8_t *put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    at[2] = (uint8_t)(value >> 16);
    at[3] = (uint8_t)(value >> 24);
    return at + 4;
}

static uint8_t *put_floats(uint8_t *at, const float *values, uint8_t count) {
    for (uint8_t i = 0; i < count; i++) {
        uint32_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        at = put32(at, bits);
    }
    return at;
}

/* Not isfinite: -ffast-math, which boards are often built with, takes every number for finite. */
static int is_finite(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits & 0x7f800000u) != 0x7f800000u;
}

static int is_positive(float value) { return is_finite(value) && value > 0.0f; }

static void count(uint16_t *counter) { *counter = (uint16_t)(*counter + (*counter < UINT16_MAX)); }

uint16_t mhb_crc(const uint8_t *data, size_t length) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)data[i] << 8);
        for (int bit = 0; bit < 8; bit++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

size_t mhb_code(const uint8_t *data, size_t length, uint8_t *out) {
    size_t head = 0, end = 1; /* out[head] will be the distance to the next zero */
    for (size_t i = 0; i < length; i++) {
        if (data[i]) out[end++] = data[i];
        if (!data[i] || end - head == 255) {
            out[head] = (uint8_t)(end - head);
            head = end++;
            if (data[i] && i + 1 == length) return head; /* a full block at the end needs no empty one after it */
        }
    }
    out[head] = (uint8_t)(end - head);
    return end;
}

size_t mhb_decode(const uint8_t *data, size_t length, uint8_t *out) {
    size_t end = 0;
    for (size_t i = 0; i < length;) {
        uint8_t block = data[i++];
        if (!block || block - 1u > length - i) return (size_t)-1;
        for (uint8_t k = 1; k < block; k++) {
            if (!data[i]) return (size_t)-1;
            out[end++] = data[i++];
        }
        if (block < 255 && i < length) out[end++] = 0;
    }
    return end;
}

int mhb_init(mhb *board, const mhb_about *about) {
    memset(board, 0, sizeof *board);
    if (!about->axes || about->axes > MHB_AXES || !about->period_us || !about->longest_us) return -1;
    if (about->longest_us > INT32_MAX) return -1; /* half of what the clock can count */
    for (uint8_t i = 0; i < about->axes; i++) {
        if (!is_positive(about->force[i]) || !is_positive(about->displacement[i])) return -1;
        if (!is_positive(about->speed[i]) || !(about->step[i] >= 0.0f) || !(about->mass[i] >= 0.0f)) return -1;
    }
    board->about = *about;
    return 0;
}

/* From now to an instant of the same clock, us; within half of its range. */
static int32_t left_of(uint32_t until_us, uint32_t now_us) {
    const uint32_t left = until_us - now_us;
    return left < 0x80000000u ? (int32_t)left : -(int32_t)(UINT32_MAX - left) - 1;
}

static void let_go(mhb *board) { board->holding = 0; }

static void hear_hello(mhb *board, const uint8_t *payload) {
    board->nonce = u32(payload + 3);
    board->asked = 1; /* whatever versions the host knows: so it can say which the board has */
    board->greeted = payload[1] <= MHB_VERSION && payload[2] >= MHB_VERSION;
    board->has_force = board->saturated = board->expired = 0;
    board->states = 0;
    let_go(board);
}

static void hear_force(mhb *board, const uint8_t *payload, uint32_t now_us) {
    const uint16_t sequence = u16(payload + 1);
    if (!board->greeted) {
        count(&board->counts.early);
        return;
    }
    if (board->has_force && (uint16_t)(sequence - board->sequence - 1u) >= 0x8000u) {
        count(&board->counts.old);
        return;
    }
    for (uint8_t i = 0; i < board->about.axes; i++) {
        if (!is_finite(f32(payload + 7 + 4 * i))) {
            count(&board->counts.unusable);
            let_go(board);
            return;
        }
    }
    board->saturated = board->expired = 0;
    for (uint8_t i = 0; i < board->about.axes; i++) {
        const float asked = f32(payload + 7 + 4 * i), most = board->about.force[i];
        const float given = asked > most ? most : asked < -most ? -most : asked;
        board->saturated |= given != asked;
        board->force[i] = given;
    }
    board->sequence = sequence;
    board->has_force = 1;
    board->until = u32(payload + 3);
    const int32_t left = left_of(board->until, now_us);
    if (left > (int32_t)board->about.longest_us) board->until = now_us + board->about.longest_us;
    board->holding = left > 0;
    if (!board->holding) {
        board->expired = 1; /* it was on its way for longer than it may live */
        count(&board->counts.late);
    }
}

static void hear(mhb *board, const uint8_t *payload, size_t length, uint32_t now_us) {
    const size_t force_length = 7u + 4u * board->about.axes;
    if (length < 3 || mhb_crc(payload, length - 2) != u16(payload + length - 2)) {
        count(&board->counts.broken);
        return;
    }
    length -= 2;
    if (payload[0] == HELLO && length == 7) {
        hear_hello(board, payload);
    } else if (payload[0] == FORCE && length == force_length) {
        hear_force(board, payload, now_us);
    } else if (payload[0] == FORCE || payload[0] == HELLO) {
        count(&board->counts.broken);
    } else {
        count(&board->counts.unknown);
    }
}

void mhb_take(mhb *board, uint8_t byte, uint32_t now_us) {
    if (byte) {
        if (board->length == sizeof board->in) {
            board->lost = 1; /* longer than any frame: nothing of it counts until its end */
        } else {
            board->in[board->length++] = byte;
        }
        return;
    }
    if (board->lost) {
        count(&board->counts.broken);
    } else if (board->length) {
        uint8_t payload[MHB_FRAME];
        const size_t length = mhb_decode(board->in, board->length, payload);
        if (length == (size_t)-1) {
            count(&board->counts.broken);
        } else {
            hear(board, payload, length, now_us);
        }
    }
    board->length = board->lost = 0;
}

const float *mhb_force(mhb *board, uint32_t now_us) {
    if (board->holding && left_of(board->until, now_us) <= 0) {
        board->expired = 1; /* for good: the clock wraps, and the force must not come back with it */
        let_go(board);
    }
    return board->holding ? board->force : board->zero;
}

static size_t seal(uint8_t *payload, const uint8_t *end, uint8_t *out) {
    const size_t length = (size_t)(end - payload);
    put16(payload + length, mhb_crc(payload, length));
    const size_t coded = mhb_code(payload, length + 2, out);
    out[coded] = 0;
    return coded + 1;
}

static size_t answer(mhb *board, uint8_t *out) {
    const mhb_about *about = &board->about;
    uint8_t payload[MHB_PAYLOAD], *at = payload;
    *at++ = ABOUT;
    *at++ = MHB_VERSION;
    at = put32(at, board->nonce);
    memcpy(at, about->name, MHB_NAME);
    at += MHB_NAME;
    *at++ = about->axes;
    *at++ = about->rotations;
    *at++ = about->features;
    at = put32(at, about->period_us);
    at = put32(at, about->longest_us);
    const float *of_axes[] = {about->force, about->displacement, about->speed, about->step, about->mass};
    for (size_t i = 0; i < sizeof of_axes / sizeof *of_axes; i++) at = put_floats(at, of_axes[i], about->axes);
    board->asked = 0;
    return seal(payload, at, out);
}

size_t mhb_state(mhb *board, uint32_t now_us, const float *x, const float *exerted, uint8_t status, int64_t work,
                 uint8_t *out) {
    if (board->asked) return answer(board, out);
    if (!board->greeted) return 0;
    mhb_force(board, now_us);
    status &= (uint8_t) ~(MHB_SATURATED | MHB_EXPIRED);
    status |= (uint8_t)((board->saturated ? MHB_SATURATED : 0) | (board->expired ? MHB_EXPIRED : 0));
    uint8_t payload[MHB_PAYLOAD], *at = payload;
    *at++ = STATE;
    at = put16(at, board->states++);
    at = put16(at, board->sequence);
    at = put32(at, now_us);
    *at++ = status;
    *at++ = board->has_force;
    at = put_floats(at, x, board->about.axes);
    at = put_floats(at, exerted, board->about.axes);
    if (board->about.features & MHB_TELLS_WORK) {
        at = put32(at, (uint32_t)(uint64_t)work);
        at = put32(at, (uint32_t)((uint64_t)work >> 32));
    }
    return seal(payload, at, out);
}
