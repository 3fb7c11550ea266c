/* The firmware's core under a fuzzer of its own, built with the sanitizers: frames that are nearly right, any clock.
 *
 *     fuzz_mhb SECONDS SEED
 *
 * What must hold at any instant: every force within its limits and its time, states that decode, counters that only
 * grow, and no access outside the structure. Ends with 0 and the number of frames, or at the first failure.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "mhb.h"

#define REQUIRE(what) \
    do { \
        if (!(what)) { \
            fprintf(stderr, "frame %llu of seed %llu: expected %s\n", frames, seed, #what); \
            return 1; \
        } \
    } while (0)

static unsigned long long frames, seed, dice;

static uint32_t any(void) { /* xorshift64* */
    dice ^= dice >> 12, dice ^= dice << 25, dice ^= dice >> 27;
    return (uint32_t)((dice * 2685821657736338717ull) >> 32);
}

static uint32_t below(uint32_t n) { return any() % n; }

static float a_float(void) {
    static const uint32_t odd[] = {0, 0x80000000, 0x7f800000, 0xff800000, 0x7fc00000, 0x7f7fffff, 0x00000001, 0x40a00000};
    uint32_t bits = below(3) ? any() : odd[below(8)];
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static size_t a_payload(uint8_t *out, uint8_t axes, uint32_t now) {
    static const uint32_t spans[] = {0, 1, 1000, 50000, 50001, 0x7fffffff, 0x80000000, 0xffffffff};
    size_t n = 0;
    out[n++] = below(8) ? (uint8_t)(1 + below(2)) : (uint8_t)any();
    if (out[0] == 1) {
        out[n++] = below(8) ? 1 : (uint8_t)any(), out[n++] = below(8) ? 1 : (uint8_t)any();
        for (int i = 0; i < 4; i++) out[n++] = (uint8_t)any();
    } else {
        const uint32_t until = now + (below(3) ? spans[below(8)] : any());
        out[n++] = (uint8_t)any(), out[n++] = (uint8_t)any();
        for (int i = 0; i < 4; i++) out[n++] = (uint8_t)(until >> 8 * i);
        for (uint8_t a = 0; a < axes; a++) {
            const float f = a_float();
            memcpy(out + n, &f, 4), n += 4;
        }
    }
    if (!below(8)) n = below((uint32_t)n + 1);
    while (!below(8) && n < 180) out[n++] = (uint8_t)any();
    return n;
}

int main(int argc, char **argv) {
    if (argc != 3) return 2;
    const double seconds = atof(argv[1]);
    seed = strtoull(argv[2], NULL, 10), dice = seed * 2 + 1;
    const time_t end = time(NULL) + (time_t)seconds;
    while (time(NULL) < end) {
        mhb board;
        mhb_about about = {"fuzz", (uint8_t)(1 + below(6)), 0, (uint8_t)below(4), 500, 1 + below(100000), {0}, {0}, {0}, {0}, {0}};
        for (int i = 0; i < about.axes; i++) about.force[i] = about.displacement[i] = about.speed[i] = 0.5f + (float)below(9);
        REQUIRE(mhb_init(&board, &about) == 0);
        uint32_t now = any();
        mhb_counts before = board.counts;
        for (int k = 0; k < 2000; k++) {
            uint8_t payload[200], coded[256], out[MHB_FRAME];
            size_t n = a_payload(payload, about.axes, now);
            if (below(10)) {
                const uint16_t crc = mhb_crc(payload, n);
                payload[n] = (uint8_t)crc, payload[n + 1] = (uint8_t)(crc >> 8), n += 2;
            }
            size_t length = mhb_code(payload, n, coded);
            uint8_t back[256];
            REQUIRE(mhb_decode(coded, length, back) == n && !memcmp(back, payload, n));
            if (below(10)) coded[length++] = 0;
            if (!below(6) && length) coded[below((uint32_t)length)] = (uint8_t)any();
            for (size_t i = 0; i < length; i++) mhb_take(&board, coded[i], now);
            frames++;
            const float *f = mhb_force(&board, now);
            for (int i = 0; i < about.axes; i++) REQUIRE(fabsf(f[i]) <= about.force[i]);
            float x[MHB_AXES];
            for (int i = 0; i < MHB_AXES; i++) x[i] = a_float();
            const size_t sent = mhb_state(&board, now, x, x, (uint8_t)any(), (int64_t)any() << 20, out);
            REQUIRE(sent <= sizeof out && (sent == 0 || (out[sent - 1] == 0 && !memchr(out, 0, sent - 1))));
            if (sent) {
                const size_t m = mhb_decode(out, sent - 1, back);
                REQUIRE(m != (size_t)-1 && m > 2 && mhb_crc(back, m - 2) == (uint16_t)(back[m - 2] | back[m - 1] << 8));
            }
            REQUIRE(board.counts.broken >= before.broken && board.counts.old >= before.old && board.counts.late >= before.late);
            before = board.counts;
            if (!below(100)) /* a stream without an end */
                for (uint32_t i = below(1000); i; i--) mhb_take(&board, (uint8_t)(1 + below(255)), now);
            if (!below(20)) { /* any code, at the end of what may be read */
                const size_t size = below(40);
                uint8_t *exact = malloc(size + 1);
                for (size_t i = 0; i < size; i++) exact[i] = below(4) ? (uint8_t)below(40) : (uint8_t)any();
                uint8_t *end_of = realloc(exact, size ? size : 1);
                const size_t m = mhb_decode(end_of, size, back);
                REQUIRE(m == (size_t)-1 || m <= size);
                free(end_of);
            }
            if (below(4)) now += below(3000);
            if (!below(50)) { /* silence: whatever came, it ends */
                now += about.longest_us;
                f = mhb_force(&board, now);
                for (int i = 0; i < about.axes; i++) REQUIRE(f[i] == 0.0f);
                now += any() & 0x7fffffff;
                f = mhb_force(&board, now);
                for (int i = 0; i < about.axes; i++) REQUIRE(f[i] == 0.0f);
            }
        }
    }
    printf("%llu frames\n", frames);
    return 0;
}
