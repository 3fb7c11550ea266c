/* A fake board: the firmware's core and plants behind a file descriptor, in real time, with failures to order.
 *
 *     board FD PERIOD_US LONGEST_US FEATURES AXES [m b c step k amplitude frequency force displacement speed]...
 *
 * FD is the master of a pseudo-terminal. Orders come as lines on standard input:
 *
 *     stall MS      neither read nor send for so long, as a busy bus does; what was to be sent comes at once afterwards
 *     mute, speak   send nothing any more, but go on reading; and send again
 *     reset         begin anew, as after a brown-out: no host has said hello
 *     drop N        leave out the next N states
 *     noise N       send N random bytes in a frame's place
 *     brake, free   the board's own protection takes the motors away, and gives them back
 *     scale K       from now on all displacements are K times what they are, as after an update with another unit
 *     unplug        the line is gone, and what was on it; the motors keep their power
 *     plug PATH     a new line, whose port PATH leads to
 *     forever       from now on every force is held until the next one: a firmware without a watchdog
 *     note WORDS    nothing but a line of the log
 *     log PATH      from now on write down what happens, a line each, with its instant (CLOCK_MONOTONIC, ns):
 *                   "o AT ORDER", "m AT f..." (the force that the motors get), "r AT BYTES" (what was read, in hex),
 *                   "b AT US" (this process had no turn for so long), and first "c AT US" (what its clock showed then)
 *     ask           answer on standard output: "x ... f ... broken ... late ..." of this instant
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "mhb.h"
#include "plant.h"

static mhb board;
static mhb_about about;
static plant plants[MHB_AXES];
static int fd, far_end = -1;
static char port[256]; /* that leads to its line, once it was plugged in by an order */
static FILE *noted;
static uint64_t began_ns, stalled_until_us;
static unsigned drop, noise;
static int mute, braked, forever;
static uint64_t moved; /* us, up to which it has lived */
static double work;
static float x[MHB_AXES], f[MHB_AXES];
static double scale = 1.0;
static uint8_t late[1 << 20]; /* what a stalled bus has not delivered yet */
static size_t late_length;

static uint64_t now_us(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    /* it begins a second before its wrap, so that every test of a second crosses it */
    return ((uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec - began_ns) / 1000u;
}

static uint32_t clock_us(uint64_t us) { return (uint32_t)(us + 0xFFFFFFFFu - 1000000u); }

static unsigned long long instant(uint64_t us) { return began_ns + 1000u * us; }

static void note(char what, uint64_t us, const char *words) {
    if (noted) fprintf(noted, "%c %llu%s%s\n", what, instant(us), *words ? " " : "", words);
}

static void note_force(uint64_t us, const float *f) {
    if (!noted) return;
    fprintf(noted, "m %llu", instant(us));
    for (int i = 0; i < about.axes; i++) fprintf(noted, " %.9g", (double)f[i]);
    fprintf(noted, "\n");
}

static void note_read(const uint8_t *data, ssize_t length) {
    if (!noted || length <= 0) return;
    fprintf(noted, "r %llu ", instant(now_us()));
    for (ssize_t i = 0; i < length; i++) fprintf(noted, "%02x", data[i]);
    fprintf(noted, "\n");
}

static void unplug(void) {
    if (*port) unlink(port);
    if (far_end >= 0) close(far_end);
    if (fd >= 0) close(fd);
    fd = far_end = -1;
    late_length = 0;
}

static void plug(const char *path) {
    unplug();
    snprintf(port, sizeof port, "%s", path);
    fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (fd < 0 || grantpt(fd) || unlockpt(fd)) exit(4);
    /* an end that stays open: without one a line hangs up when its reader goes */
    far_end = open(ptsname(fd), O_RDWR | O_NOCTTY);
    struct termios mode;
    if (far_end < 0 || tcgetattr(far_end, &mode)) exit(4);
    cfmakeraw(&mode);
    if (tcsetattr(far_end, TCSANOW, &mode) || symlink(ptsname(fd), port)) exit(4);
}

static void put(const uint8_t *data, size_t length) {
    if (now_us() < stalled_until_us) {
        if (late_length + length <= sizeof late) memcpy(late + late_length, data, length), late_length += length;
        return;
    }
    if (late_length) {
        const size_t kept = late_length;
        late_length = 0;
        put(late, kept);
    }
    while (length) {
        const ssize_t n = write(fd, data, length);
        if (n < 0) return; /* nobody reads: what a UART does */
        data += n, length -= (size_t)n;
    }
}

/* The board lives up to this instant; the motors hold what the last look at the clock gave them, 50 us at most. */
static void advance(uint64_t at) {
    while (moved < at) {
        const uint64_t to = moved + 50u < at ? moved + 50u : at;
        const float *given = forever && board.has_force ? board.force : mhb_force(&board, clock_us(moved));
        int changed = 0;
        for (int i = 0; i < about.axes; i++) {
            const float before = f[i];
            f[i] = braked ? 0.0f : given[i];
            changed |= f[i] != before;
            const double done = plants[i].work;
            plant_advance(&plants[i], (double)f[i], 1e-6 * (double)(to - moved));
            work += plants[i].work - done;
        }
        if (changed) note_force(moved, f);
        moved = to;
    }
}

static void order(const char *line) {
    unsigned n;
    note('o', now_us(), line);
    if (sscanf(line, "stall %u", &n) == 1) stalled_until_us = now_us() + 1000u * n;
    else if (!strncmp(line, "note ", 5)) return;
    else if (!strncmp(line, "mute", 4)) mute = 1;
    else if (!strncmp(line, "speak", 5)) mute = 0;
    else if (!strncmp(line, "unplug", 6)) unplug();
    else if (!strncmp(line, "plug ", 5)) plug(line + 5);
    else if (!strncmp(line, "forever", 7)) forever = 1;
    else if (!strncmp(line, "log ", 4)) {
        noted = fopen(line + 4, "w");
        if (!noted) exit(5);
        fprintf(noted, "c %llu %u\n", instant(0), clock_us(0));
        note_force(now_us(), f);
    }
    else if (!strncmp(line, "reset", 5)) mhb_init(&board, &about);
    else if (sscanf(line, "drop %u", &drop) == 1 || sscanf(line, "noise %u", &noise) == 1) return;
    else if (!strncmp(line, "brake", 5)) braked = 1;
    else if (!strncmp(line, "free", 4)) braked = 0;
    else if (sscanf(line, "scale %lf", &scale) == 1) return;
    else if (!strncmp(line, "ask", 3)) {
        printf("x");
        for (int i = 0; i < about.axes; i++) printf(" %.9g", (double)x[i]);
        printf(" f");
        for (int i = 0; i < about.axes; i++) printf(" %.9g", (double)f[i]);
        printf(" broken %u early %u old %u late %u unusable %u unknown %u\n", board.counts.broken, board.counts.early,
               board.counts.old, board.counts.late, board.counts.unusable, board.counts.unknown);
        fflush(stdout);
        if (noted) fflush(noted);
    } else {
        exit(3);
    }
}

int main(int argc, char **argv) {
    if (argc < 6) return 2;
    fd = atoi(argv[1]);
    strcpy(about.name, "fake board");
    about.period_us = (uint32_t)atoi(argv[2]), about.longest_us = (uint32_t)atoi(argv[3]);
    about.features = (uint8_t)atoi(argv[4]), about.axes = (uint8_t)atoi(argv[5]);
    if (argc != 6 + 10 * about.axes) return 2;
    for (int i = 0; i < about.axes; i++) {
        char **of = argv + 6 + 10 * i;
        plants[i] = (plant){atof(of[0]), atof(of[1]), atof(of[2]), atof(of[3]), atof(of[4]), atof(of[5]), atof(of[6]), 0, 0, 0, 0};
        about.mass[i] = (float)plants[i].m, about.step[i] = (float)plants[i].step;
        about.force[i] = (float)atof(of[7]), about.displacement[i] = (float)atof(of[8]), about.speed[i] = (float)atof(of[9]);
    }
    if (mhb_init(&board, &about)) return 2;
    fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    fcntl(0, F_SETFL, fcntl(0, F_GETFL) | O_NONBLOCK);
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    began_ns = (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
    uint64_t due = 0;
    char line[256];
    size_t filled = 0;
    for (;;) {
        uint64_t at = now_us();
        do { /* once at least: a board that is behind goes on reading */
            struct timespec left = {0, at < due ? (long)(1000u * (due - at)) : 0};
            struct pollfd both[2] = {{fd, POLLIN, 0}, {0, POLLIN, 0}};
            ppoll(both, 2, &left, NULL);
            advance(now_us()); /* before what is heard now changes anything */
            if (both[1].revents) {
                const ssize_t n = read(0, line + filled, sizeof line - 1 - filled);
                if (n == 0) return 0; /* its test has ended */
                if (n > 0) filled += (size_t)n;
                line[filled] = 0;
                for (char *end; (end = strchr(line, '\n'));) {
                    *end = 0;
                    order(line);
                    filled -= (size_t)(end + 1 - line);
                    memmove(line, end + 1, filled + 1);
                }
            }
            if (both[0].revents & POLLIN && now_us() >= stalled_until_us) {
                uint8_t data[512];
                const ssize_t n = read(fd, data, sizeof data);
                note_read(data, n);
                for (ssize_t i = 0; i < n; i++) mhb_take(&board, data[i], clock_us(now_us()));
            } else if (both[0].revents) {
                usleep(50); /* nobody has opened the other end, or the bus is stalled */
            }
            at = now_us();
        } while (at < due);
        if (noted && at > due + 1000u) {
            char words[24];
            snprintf(words, sizeof words, "%llu", (unsigned long long)(at - due));
            note('b', at, words);
        }
        due += about.period_us;
        if (at > due + 100000u) due = at; /* the machine was busy for long: a board does not make up for it */
        advance(at);
        for (int i = 0; i < about.axes; i++) x[i] = (float)(scale * plant_seen(&plants[i]));
        uint8_t frame[MHB_FRAME];
        const uint8_t status = (uint8_t)(MHB_CALIBRATED | MHB_READY | (braked ? MHB_BRAKED : 0));
        const size_t n = mhb_state(&board, clock_us(at), x, f, status, (int64_t)(1e9 * work), frame);
        if (mute) continue;
        if (drop && n) {
            drop--;
        } else if (noise && n) {
            for (; noise; noise--) {
                const uint8_t byte = (uint8_t)rand();
                put(&byte, 1);
            }
        } else {
            put(frame, n);
        }
    }
}
