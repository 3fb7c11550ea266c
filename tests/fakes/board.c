/* A fake board: the firmware's core and plants behind a file descriptor, in real time, with failures to order.
 *
 *     board FD PERIOD_US LONGEST_US FEATURES AXES [m b c step k amplitude frequency force displacement speed]...
 *
 * FD is the master of a pseudo-terminal. Orders come as lines on standard input:
 *
 *     stall MS      neither read nor send for so long, as a busy bus does; what was to be sent comes at once afterwards
 *     mute          send nothing any more; go on reading
 *     reset         begin anew, as after a brown-out: no host has said hello
 *     drop N        leave out the next N states
 *     noise N       send N random bytes in a frame's place
 *     brake, free   the board's own protection takes the motors away, and gives them back
 *     scale K       from now on all displacements are K times what they are, as after an update with another unit
 *     ask           answer on standard output: "x ... f ... broken ... late ..." of this instant
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "mhb.h"
#include "plant.h"

static mhb board;
static mhb_about about;
static plant plants[MHB_AXES];
static int fd;
static uint64_t began_ns, stalled_until_us;
static unsigned drop, noise;
static int mute, braked;
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

static void order(const char *line, const float *x, const float *f) {
    unsigned n;
    if (sscanf(line, "stall %u", &n) == 1) stalled_until_us = now_us() + 1000u * n;
    else if (!strncmp(line, "mute", 4)) mute = 1;
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
    uint64_t due = 0, moved = 0;
    double work = 0.0;
    float x[MHB_AXES] = {0}, f[MHB_AXES] = {0};
    char line[256];
    size_t filled = 0;
    for (;;) {
        /* the motors hold what the last look at the clock gave them; a look every 20 us at most */
        uint64_t at = now_us();
        while (at < due) {
            struct timespec left = {0, (long)(1000u * (due - at))};
            struct pollfd both[2] = {{fd, POLLIN, 0}, {0, POLLIN, 0}};
            ppoll(both, 2, &left, NULL);
            if (both[1].revents) {
                const ssize_t n = read(0, line + filled, sizeof line - 1 - filled);
                if (n == 0) return 0; /* its test has ended */
                if (n > 0) filled += (size_t)n;
                line[filled] = 0;
                for (char *end; (end = strchr(line, '\n'));) {
                    *end = 0;
                    order(line, x, f);
                    filled -= (size_t)(end + 1 - line);
                    memmove(line, end + 1, filled + 1);
                }
            }
            if (both[0].revents & POLLIN && now_us() >= stalled_until_us) {
                uint8_t data[512];
                const ssize_t n = read(fd, data, sizeof data);
                for (ssize_t i = 0; i < n; i++) mhb_take(&board, data[i], clock_us(now_us()));
            } else if (both[0].revents) {
                usleep(50); /* nobody has opened the other end, or the bus is stalled */
            }
            at = now_us();
        }
        due += about.period_us;
        if (at > due + 100000u) due = at; /* the machine was busy for long: a board does not make up for it */
        while (moved < at) {
            const uint64_t to = moved + 50u < at ? moved + 50u : at;
            const float *given = mhb_force(&board, clock_us(moved));
            for (int i = 0; i < about.axes; i++) {
                f[i] = braked ? 0.0f : given[i];
                const double before = plants[i].work;
                plant_advance(&plants[i], (double)f[i], 1e-6 * (double)(to - moved));
                work += plants[i].work - before;
            }
            moved = to;
        }
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
