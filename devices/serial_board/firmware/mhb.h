/* The board's end of the manyhands board protocol, version 1: see ../PROTOCOL.md.
 *
 * Portable C99 for boards without an operating system. It needs no memory but its own structure, calls nothing but
 * memcpy and memset, and never waits. It does no arithmetic on forces but to limit them.
 *
 *     static mhb board;
 *     mhb_init(&board, &about);
 *     for (;;) {                                   the board's own loop, at its own rate
 *         while (uart_has_byte()) mhb_take(&board, uart_byte(), micros());
 *         read the encoders into x
 *         const float *f = mhb_force(&board, micros());
 *         put f on the motors
 *         size_t n = mhb_state(&board, micros(), x, f, status, work, frame);
 *         uart_send(frame, n);                     0 bytes while no host has said hello
 *     }
 *
 * mhb_force returns zeros once the time of the last force is over. So a board whose loop runs needs no other watchdog
 * against a host that is silent; a board whose loop may hang needs its processor's watchdog as well.
 */
#ifndef MHB_H
#define MHB_H

#include <stddef.h>
#include <stdint.h>

#define MHB_VERSION 1
#define MHB_AXES 6        /* the most that a board may have */
#define MHB_NAME 16       /* bytes of a board's name, filled up with zeros */
#define MHB_PAYLOAD 160   /* the longest payload with its checksum, bytes: ABOUT of six axes has 155 */
#define MHB_FRAME (MHB_PAYLOAD + 2) /* coded, with its end: COBS adds one byte in 254 */

/* the status of a board, bits */
#define MHB_CALIBRATED 0x01 /* its positions are counted from where they say */
#define MHB_READY 0x02      /* its motors have power */
#define MHB_SATURATED 0x04  /* the last force was cut to the limits */
#define MHB_EXPIRED 0x08    /* the last force has ended by itself */
#define MHB_BRAKED 0x10     /* its own protection keeps it from exerting forces */
#define MHB_FAULT 0x20      /* anything else that keeps it from obeying */

/* what a board is, bits */
#define MHB_TELLS_WORK 0x01   /* STATE has the work of its motors */
#define MHB_HOLDS_TORQUE 0x02 /* between two updates its motors hold the torques of joints, not the force */

typedef struct {
    char name[MHB_NAME];
    uint8_t axes;               /* 1 to MHB_AXES */
    uint8_t rotations;          /* bit i: axis i turns; then m, N and m/s are rad, N m and rad/s */
    uint8_t features;           /* MHB_TELLS_WORK, MHB_HOLDS_TORQUE */
    uint32_t period_us;         /* from one STATE to the next */
    uint32_t longest_us;        /* the longest time that a force may live */
    float force[MHB_AXES];      /* the greatest force, N */
    float displacement[MHB_AXES]; /* the greatest displacement from 0, m */
    float speed[MHB_AXES];      /* the greatest speed that it measures rightly, m/s */
    float step[MHB_AXES];       /* of its encoder, m; 0 where it is not known */
    float mass[MHB_AXES];       /* the least moving mass, kg; 0 where it is not known */
} mhb_about;

/* frames that were not obeyed, by reason; each counter stays at its greatest value */
typedef struct {
    uint16_t broken;  /* no frame: wrong coding, checksum or length */
    uint16_t unknown; /* of a kind that this version does not know */
    uint16_t early;   /* before a hello */
    uint16_t old;     /* a force older than the last one */
    uint16_t late;    /* a force whose time was over when it came */
    uint16_t unusable; /* a force that is no finite number */
} mhb_counts;

typedef struct {
    mhb_about about;
    mhb_counts counts;
    uint8_t in[MHB_FRAME]; /* the coded frame that is coming */
    size_t length;
    uint8_t lost;          /* whether the rest of a frame is skipped */
    uint8_t greeted;       /* whether a host has said hello */
    uint8_t asked;         /* whether that hello is still to be answered */
    uint8_t saturated, expired, holding;
    uint32_t nonce;
    uint16_t sequence;     /* of the last force */
    uint8_t has_force;     /* whether there was one since the hello */
    uint16_t states;       /* of the next STATE */
    uint32_t until;        /* when the force ends, by the board's clock, us */
    float force[MHB_AXES], zero[MHB_AXES];
} mhb;

/* Begin, with no force. Returns 0, or -1 where `about` is none: axes, period or a limit out of range. */
int mhb_init(mhb *board, const mhb_about *about);

/* Take a byte that came at now_us, by the board's clock, which counts microseconds, wraps, and goes on while it runs. */
void mhb_take(mhb *board, uint8_t byte, uint32_t now_us);

/* The force to exert now, N, axes entries; zeros where none lives. Valid until the next call. */
const float *mhb_force(mhb *board, uint32_t now_us);

/* Write what is to be sent now to `out`, MHB_FRAME bytes: ABOUT where a hello is to be answered, else STATE.
 * Returns its length; 0 before any hello.
 *
 * x: displacement, m. exerted: the force that is exerted, N. status: MHB_CALIBRATED and so on; the core adds
 * MHB_SATURATED and MHB_EXPIRED. work: of the motors since power came, nJ; not sent unless MHB_TELLS_WORK. */
size_t mhb_state(mhb *board, uint32_t now_us, const float *x, const float *exerted, uint8_t status, int64_t work,
                 uint8_t *out);

/* CRC-16 of ITU-T V.41 with 0xFFFF to begin with ("CCITT-FALSE"). */
uint16_t mhb_crc(const uint8_t *data, size_t length);

/* Consistent overhead byte stuffing [Cheshire1999]: out needs length + length/254 + 1 bytes; the end's 0 is not written.
 * Returns the coded length. */
size_t mhb_code(const uint8_t *data, size_t length, uint8_t *out);

/* The reverse, in place or not; returns the length, or (size_t)-1 where the data are no code. */
size_t mhb_decode(const uint8_t *data, size_t length, uint8_t *out);

#endif
