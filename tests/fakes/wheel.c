/* A fake wheel: what evdev and a kernel driver do with force-feedback effects, and plants behind a USB, in real time.
 *
 *     wheel SOCKET KIND HZ IN_US OUT_US AXES [m b c step k amplitude frequency most range]...
 *
 * Processes speak to it over SOCKET (evdev_rpc.h); each connection is one open file of the device. KIND is the kernel
 * driver, each as its source has it:
 *
 *     memless  ff-memless.c and hid-lg4ff.c: forces leave in the kernel's next tick, as 8 bits; an upload counts the
 *              length from there, but the length that was there before; the device holds what it was sent last
 *     lg4ff    berarma/new-lg4ff: a timer of 2 ms; lengths are counted in ticks, from an upload or a start
 *     pid      hid-pidff.c: reports leave at once, those that have changed; the device itself counts, from a start
 *     tmff2    Kimplul/hid-tmff2: as pid, with a timer of 8 ms
 *
 * Positions go up every IN_US, as old as that; reports go down one in OUT_US. The device begins with a spring to its
 * middle, with less than full gain, and with a filter of its axes: who leaves these as they are feels it. Orders come as
 * lines on standard input:
 *
 *     stall MS             nothing goes up or down for so long; what was to go down goes afterwards
 *     unplug, plug         the device is away, and back as new
 *     manual, advance US   time stands still but for this
 *     deny N, busy N, full N    1: no permission; another program's grab; no room for effects. 0 again
 *     without CODE         the device has no such FF code (decimal); 21 for no force feedback at all
 *     frozen               a new level counts at a start from rest alone
 *     endless              no force ends by its length
 *     mirror               forces push the other way
 *     weak K               forces are K times what they should be
 *     late US              reports take so much longer
 *     range RAD            it was set to another range from stop to stop
 *     still N              1: the kernel driver takes all calls, and plays nothing any more; 0 again
 *     refuse N             1: the kernel driver refuses new levels; 0 again
 *     keep N               1: it does not stop the effects of a process that has died; 0 again
 *     note WORDS           nothing but a line of the log
 *     log PATH             from now on write down what happens, a line each, with its instant (CLOCK_MONOTONIC, ns):
 *                          "m AT f..." (torques, N m), "a AT KIND VALUE" (a report that has come: level, length in ms,
 *                          start, stop), "o AT WORDS" (a note), and "b AT US" (this process had no turn for so long)
 *     flood                64 changes at once, more than a reader's queue has room for
 *     ask                  answer: "x ... f ... uploads ... queued ... playing ... auto ... gain ... fuzz ... opened"
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/input.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "evdev_rpc.h"
#include "plant.h"

#define AXES 2
#define CLIENTS 8
#define EFFECTS 16
#define QUEUE 64     /* EVDEV_MIN_BUFFER_SIZE */
#define REPORTS 256  /* HID_OUTPUT_FIFO_SIZE */
#define STEP_US 50
#define COUNTS 65535

enum { MEMLESS, LG4FF, PID, TMFF2 };
static const char *kinds[] = {"memless", "lg4ff", "pid", "tmff2"};

typedef struct {
    int fd, clock;
    struct input_event queue[QUEUE];
    int head, tail; /* one entry stays free */
} client;

typedef struct {
    int used, owner, started, update, begin, stop;
    struct ff_effect effect;
    int level;                    /* that the kernel driver last took */
    uint64_t stop_ticks; /* of the kernel driver */
} effect;

/* what the device itself knows of an effect, and one report to it */
typedef struct { int level, length, on; uint64_t since; double dx, dy; } slot;
typedef struct { int op, id, value, x, y; uint64_t sent; double dx, dy; } report;
enum { LEVEL, LENGTH, START, STOP, FORCES };

static int axes, kind, manual, present = 1, deny, busy, full, frozen, endless, without[0x80], lacking;
static unsigned hz, in_us, out_us;
static plant plants[AXES];
static double most[AXES], sign = 1.0, weak = 1.0, torque[AXES];
static int published[AXES], prepared[AXES], fuzz[AXES];
static client clients[CLIENTS];
static int grabbed, opened;
static effect effects[EFFECTS];
static slot slots[EFFECTS];
static report reports[REPORTS];
static int first, waiting, forces[AXES];
static long uploads;
static int gain, autocenter;
static uint64_t at_us, stalled_until, late_us, manual_us, began_ns;
static int still, refuse, keep;
static FILE *noted;

static uint64_t real_us(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return ((uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec - began_ns) / 1000u;
}

static unsigned long long instant(uint64_t us) { return began_ns + 1000u * us; }

static void note_torques(void) {
    static double last[AXES];
    if (!noted || !memcmp(last, torque, sizeof last)) return;
    memcpy(last, torque, sizeof last);
    fprintf(noted, "m %llu", instant(at_us));
    for (int i = 0; i < axes; i++) fprintf(noted, " %.9g", torque[i] + 0.0); /* no -0 */
    fprintf(noted, "\n");
}

static int counts(const plant *p) { return COUNTS / 2 + 1 + (int)floor(plant_seen(p) / p->step + 0.5); }

static uint64_t ticks_of(uint64_t us) { return us * hz / 1000000u; }

/* --- up: reports of positions */

static void give(client *c, int type, int code, int value, uint64_t us) {
    struct input_event *e = &c->queue[c->head];
    const uint64_t t = us + began_ns / 1000u; /* the clock that the driver has asked for is the monotonic one */
    memset(e, 0, sizeof *e);
    e->time.tv_sec = (time_t)(t / 1000000u), e->time.tv_usec = (suseconds_t)(t % 1000000u);
    e->type = (__u16)type, e->code = (__u16)code, e->value = value;
    c->head = (c->head + 1) % QUEUE;
    if (c->head == c->tail) { /* all but the newest is lost */
        c->tail = (c->head + QUEUE - 2) % QUEUE;
        c->queue[c->tail] = c->queue[(c->head + QUEUE - 1) % QUEUE];
        c->queue[c->tail].type = EV_SYN, c->queue[c->tail].code = SYN_DROPPED, c->queue[c->tail].value = 0;
    }
}

static void tell(int axis, int value) {
    int old = published[axis], width = fuzz[axis];
    if (width) { /* input_defuzz_abs_event */
        const int away = abs(value - old);
        if (away < width / 2) value = old;
        else if (away < width) value = (old * 3 + value) / 4;
        else if (away < 2 * width) value = (old + value) / 2;
    }
    if (value == old) return;
    published[axis] = value;
    for (int i = 0; i < CLIENTS; i++)
        if (clients[i].fd >= 0 && (!grabbed || grabbed == i + 1)) give(&clients[i], EV_ABS, axis, value, at_us);
}

static void positions(void) {
    int before[AXES], changed = 0;
    for (int i = 0; i < axes; i++) {
        before[i] = published[i];
        tell(i, prepared[i]);
        changed |= published[i] != before[i];
        prepared[i] = counts(&plants[i]);
    }
    for (int i = 0; changed && i < CLIENTS; i++)
        if (clients[i].fd >= 0 && (!grabbed || grabbed == i + 1)) give(&clients[i], EV_SYN, SYN_REPORT, 0, at_us);
}

/* --- down: reports of forces */

static void send_down(report r) {
    if (waiting == REPORTS) return; /* "output queue full" */
    r.sent = at_us;
    reports[(first + waiting++) % REPORTS] = r;
}

static void arrive(const report *r) {
    static const char *names[] = {"level", "length", "start", "stop", "forces"};
    slot *s = &slots[r->id];
    if (noted) fprintf(noted, "a %llu %s %d\n", instant(at_us), names[r->op], r->value);
    switch (r->op) {
    case LEVEL:
        if (!frozen || !s->on) s->level = r->value;
        s->dx = r->dx, s->dy = r->dy;
        break;
    case LENGTH: s->length = r->value; break;
    case START: s->on = 1, s->since = at_us; break;
    case STOP: s->on = 0; break;
    case FORCES: forces[0] = r->x, forces[1] = r->y;
    }
}

/* the level of all effects that play, as the kernel driver sums them up */
static void sums(double *x, double *y) {
    *x = *y = 0.0;
    for (int i = 0; i < EFFECTS; i++) {
        effect *e = &effects[i];
        if (!e->used || !e->started) continue;
        if (!endless && e->effect.replay.length && ticks_of(at_us) >= e->stop_ticks) {
            e->started = 0;
            continue;
        }
        const double angle = e->effect.direction * 6.283185307179586 / 65536.0;
        *x += sin(angle) * e->level, *y += -cos(angle) * e->level;
    }
}

static void forces_down(void) {
    double x, y;
    sums(&x, &y);
    /* 8 bits are left, as of hid-lg4ff's reports */
    report r = {.op = FORCES, .x = (int)(x * gain / 0xffff) / 256 * 256, .y = (int)(y * gain / 0xffff) / 256 * 256};
    static int last[AXES];
    if (r.x != last[0] || r.y != last[1]) send_down(r);
    last[0] = r.x, last[1] = r.y;
}

static uint64_t ticks_up(unsigned ms) { return ((uint64_t)ms * hz + 999u) / 1000u; }

/* reports that hid-pidff sends for an effect, and hid-tmff2 at its timer */
static void effect_down(int id) {
    effect *e = &effects[id];
    if (e->stop) send_down((report){.op = STOP, .id = id});
    if (e->update) {
        const double angle = e->effect.direction * 6.283185307179586 / 65536.0;
        send_down((report){.op = LEVEL, .id = id, .value = e->level, .dx = sin(angle), .dy = -cos(angle)});
    }
    if (e->begin && !still) send_down((report){.op = START, .id = id});
    e->stop = e->update = e->begin = 0;
}

static int upload(struct ff_effect *asked, int owner) {
    if (asked->type != FF_CONSTANT || without[FF_CONSTANT]) return -EINVAL;
    int id = asked->id;
    const int fresh = id == -1;
    if (fresh) {
        for (id = 0; id < EFFECTS && effects[id].used; id++) ;
        if (id == EFFECTS || full) return -ENOSPC;
        memset(&effects[id], 0, sizeof effects[id]);
    } else if (id < 0 || id >= EFFECTS || !effects[id].used) {
        return -EINVAL;
    } else if (effects[id].owner != owner) {
        return -EACCES;
    }
    effect *e = &effects[id];
    const struct ff_effect old = e->effect;
    asked->id = (__s16)id;
    uploads++;
    if (kind == MEMLESS && e->started) e->stop_ticks = ticks_of(at_us) + ticks_up(old.replay.length);
    e->used = 1, e->owner = owner, e->effect = *asked;
    if (kind == LG4FF && e->started) e->stop_ticks = ticks_of(at_us) + ticks_up(asked->replay.length);
    if (!frozen || !e->started || kind >= PID) e->level = asked->u.constant.level;
    if (kind >= PID) {
        if (fresh || old.replay.length != asked->replay.length)
            send_down((report){.op = LENGTH, .id = id, .value = asked->replay.length});
        e->update |= fresh || old.u.constant.level != asked->u.constant.level;
        if (kind == PID) effect_down(id);
    }
    return id;
}

static void play(int code, int value) {
    if (code == FF_GAIN && !without[FF_GAIN]) gain = value;
    else if (code == FF_AUTOCENTER && !without[FF_AUTOCENTER]) autocenter = value;
    else if (code < EFFECTS && effects[code].used) {
        effect *e = &effects[code];
        if (value > 0) {
            if (frozen && !e->started) e->level = e->effect.u.constant.level;
            e->started = 1;
            e->stop_ticks = ticks_of(at_us) + ticks_up(e->effect.replay.length);
            e->begin = 1, e->stop &= kind == PID;
        } else {
            e->started = 0, e->stop = 1, e->begin = 0;
        }
        if (kind == PID) effect_down(code);
    }
}

static void erase(int id) {
    play(id, 0);
    if (kind == TMFF2) effect_down(id);
    effects[id].used = 0;
}

/* --- time */

static void advance(uint64_t to) {
    while (at_us + STEP_US <= to) {
        const uint64_t before = at_us;
        at_us += STEP_US;
        const int stalled = before < stalled_until;
/* nobody has made the timers, the frames and the kernel's ticks begin together */
#define PASSED(period, phase) ((at_us + (phase)) / (period) != (before + (phase)) / (period))
        if (kind == MEMLESS && ticks_of(at_us) != ticks_of(before)) forces_down();
        if (kind == LG4FF && PASSED(2000, 300)) forces_down();
        if (kind == TMFF2 && PASSED(8000, 1300))
            for (int i = 0; i < EFFECTS; i++) effect_down(i);
        if (PASSED(out_us, 650) && waiting && !stalled && at_us >= reports[first].sent + late_us) {
            arrive(&reports[first]);
            first = (first + 1) % REPORTS, waiting--;
        }
        double x = forces[0], y = forces[1];
        for (int i = 0; i < EFFECTS && kind >= PID; i++) {
            slot *s = &slots[i];
            if (s->on && !endless && s->length && at_us >= s->since + 1000u * (unsigned)s->length) s->on = 0;
            if (s->on) x += s->dx * s->level * gain / 0xffff, y += s->dy * s->level * gain / 0xffff;
        }
        const double part[AXES] = {-sign * weak * x / 0x7fff, -sign * weak * y / 0x7fff};
        for (int i = 0; i < axes; i++) {
            torque[i] = present ? most[i] * fmax(-1.0, fmin(1.0, part[i])) : 0.0;
            const double spring = present ? -0.3 * most[i] * autocenter / 0xffff * fmax(-1.0, fmin(1.0, 5.0 * plants[i].x)) : 0.0;
            plant_advance(&plants[i], torque[i] + spring, 1e-6 * STEP_US);
        }
        note_torques();
        if (PASSED(in_us, 0) && !stalled && present) positions();
    }
}

static void as_new(void) {
    memset(effects, 0, sizeof effects), memset(slots, 0, sizeof slots), memset(forces, 0, sizeof forces);
    first = waiting = grabbed = 0;
    gain = 40000, autocenter = 0xffff;
    for (int i = 0; i < axes; i++) fuzz[i] = COUNTS >> 8, published[i] = prepared[i] = counts(&plants[i]);
}

/* --- what a process asks */

static void set(uint8_t *bits, int code) { bits[code / 8] |= (uint8_t)(1 << code % 8); }

static void asked(int who, rpc_request *r, rpc_reply *a) {
    client *c = &clients[who];
    struct input_absinfo info;
    const unsigned number = _IOC_NR(r->request), size = _IOC_SIZE(r->request);
    a->size = 0, a->result = 0;
    if (r->op == RPC_OPEN) {
        opened++;
        a->result = !present ? -ENOENT : deny ? -EACCES : 0;
    } else if (!present) {
        a->result = -ENODEV;
    } else if (r->op == RPC_READ) {
        const size_t wanted = r->request / sizeof(struct input_event);
        struct input_event *to = (struct input_event *)(void *)a->data;
        size_t n = 0;
        for (; n < wanted && n < RPC_MOST / sizeof *to && c->tail != c->head; c->tail = (c->tail + 1) % QUEUE) to[n++] = c->queue[c->tail];
        a->size = (uint32_t)(n * sizeof *to), a->result = n ? (int64_t)a->size : -EAGAIN;
    } else if (r->op == RPC_WRITE) {
        const struct input_event *e = (const struct input_event *)(const void *)r->data;
        for (size_t i = 0; i < r->size / sizeof *e; i++)
            if (e[i].type == EV_FF && !lacking) play(e[i].code, e[i].value);
        a->result = r->size;
    } else if (r->request == EVIOCGRAB) {
        if (r->value && (grabbed || busy)) a->result = -EBUSY;
        else grabbed = r->value ? who + 1 : 0;
    } else if (r->request == EVIOCRMFF) {
        if (r->value < 0 || r->value >= EFFECTS || !effects[r->value].used) a->result = -EINVAL;
        else erase((int)r->value);
    } else if (r->request == EVIOCSFF) {
        struct ff_effect *e = (struct ff_effect *)(void *)r->data;
        const int id = lacking ? -ENOSYS : refuse ? -EIO : upload(e, who);
        a->result = id < 0 ? id : 0;
        if (id >= 0) memcpy(a->data, e, a->size = sizeof *e);
    } else if (r->request == EVIOCSCLOCKID) {
        c->clock = *(int *)(void *)r->data;
    } else if (number >= 0x20 && number < 0x40 && _IOC_DIR(r->request) == _IOC_READ) {
        memset(a->data, 0, a->size = size);
        if (number == 0x20) set(a->data, EV_SYN), set(a->data, EV_ABS), lacking ? (void)0 : set(a->data, EV_FF);
        for (int i = 0; number == 0x20 + EV_ABS && i < axes; i++) set(a->data, i);
        const int codes[] = {FF_RUMBLE, FF_CONSTANT, FF_GAIN, FF_AUTOCENTER};
        for (int i = 0; number == 0x20 + EV_FF && !lacking && i < 4; i++)
            if (!without[codes[i]]) set(a->data, codes[i]);
    } else if (number >= 0x40 && number < 0x40u + (unsigned)axes && _IOC_DIR(r->request) == _IOC_READ) {
        info = (struct input_absinfo){published[number - 0x40], 0, COUNTS, fuzz[number - 0x40], COUNTS >> 4, 0};
        memcpy(a->data, &info, a->size = sizeof info);
    } else if (number >= 0xC0 && number < 0xC0u + (unsigned)axes && _IOC_DIR(r->request) == _IOC_WRITE) {
        memcpy(&info, r->data, sizeof info);
        fuzz[number - 0xC0] = info.fuzz, published[number - 0xC0] = info.value;
    } else {
        a->result = -EINVAL;
    }
}

static void leave(int who) {
    close(clients[who].fd);
    clients[who].fd = -1;
    if (grabbed == who + 1) grabbed = 0;
    for (int i = 0; i < EFFECTS; i++)
        if (effects[i].used && effects[i].owner == who) keep ? (void)(effects[i].used = 0) : erase(i);
}

/* --- orders */

static void answer(void) {
    int playing = 0;
    for (int i = 0; i < EFFECTS; i++) playing += kind >= PID ? slots[i].on : effects[i].used && effects[i].started;
    printf("x");
    for (int i = 0; i < axes; i++) printf(" %.9g", plants[i].x);
    printf(" f");
    for (int i = 0; i < axes; i++) printf(" %.9g", torque[i]);
    printf(" uploads %ld queued %d playing %d auto %d gain %d fuzz %d opened %d grabbed %d\n", uploads, waiting, playing, autocenter,
           gain, fuzz[0], opened, grabbed);
    if (noted) fflush(noted);
    fflush(stdout);
}

static void order(const char *line) {
    unsigned n;
    double range;
    if (sscanf(line, "stall %u", &n) == 1) stalled_until = at_us + 1000u * n;
    else if (!strncmp(line, "unplug", 6)) present = 0, torque[0] = torque[1] = 0.0;
    else if (!strncmp(line, "plug", 4)) present = 1, as_new();
    else if (!strncmp(line, "manual", 6)) manual = 1, manual_us = at_us;
    else if (sscanf(line, "advance %u", &n) == 1) advance(manual_us += n);
    else if (sscanf(line, "deny %d", &deny) == 1 || sscanf(line, "busy %d", &busy) == 1) return;
    else if (sscanf(line, "still %d", &still) == 1 || sscanf(line, "refuse %d", &refuse) == 1) return;
    else if (sscanf(line, "keep %d", &keep) == 1) return;
    else if (sscanf(line, "range %lf", &range) == 1) for (int i = 0; i < axes; i++) plants[i].step = range / COUNTS;
    else if (!strncmp(line, "note ", 5) && noted) fprintf(noted, "o %llu %s\n", instant(at_us), line + 5);
    else if (!strncmp(line, "log ", 4)) {
        if (!(noted = fopen(line + 4, "w"))) exit(5);
        fprintf(noted, "m %llu", instant(at_us));
        for (int i = 0; i < axes; i++) fprintf(noted, " %.9g", torque[i]);
        fprintf(noted, "\n");
    }
    else if (sscanf(line, "full %d", &full) == 1 || sscanf(line, "weak %lf", &weak) == 1) return;
    else if (sscanf(line, "without %u", &n) == 1) n == EV_FF ? (lacking = 1) : (without[n & 0x7f] = 1);
    else if (!strncmp(line, "frozen", 6)) frozen = 1;
    else if (!strncmp(line, "endless", 7)) endless = 1;
    else if (!strncmp(line, "mirror", 6)) sign = -1.0;
    else if (sscanf(line, "late %u", &n) == 1) late_us = n;
    else if (!strncmp(line, "flood", 5)) {
        for (int i = 0; i < 100; i++) prepared[0] = published[0] + fuzz[0] * 2 + 3, positions();
    } else if (!strncmp(line, "ask", 3)) answer();
    else exit(3);
}

static int take_orders(void) {
    static char line[256];
    static size_t filled;
    const ssize_t n = read(0, line + filled, sizeof line - 1 - filled);
    if (n == 0) return 0; /* its test has ended */
    if (n > 0) filled += (size_t)n;
    line[filled] = 0;
    for (char *end; (end = strchr(line, '\n'));) {
        *end = 0;
        order(line);
        note_torques();
        filled -= (size_t)(end + 1 - line);
        memmove(line, end + 1, filled + 1);
    }
    return 1;
}

int main(int argc, char **argv) {
    if (argc < 7) return 2;
    for (kind = 0; kind < 4 && strcmp(kinds[kind], argv[2]); kind++) ;
    hz = (unsigned)atoi(argv[3]), in_us = (unsigned)atoi(argv[4]), out_us = (unsigned)atoi(argv[5]), axes = atoi(argv[6]);
    if (kind == 4 || axes < 1 || axes > AXES || argc != 7 + 9 * axes) return 2;
    for (int i = 0; i < axes; i++) {
        char **of = argv + 7 + 9 * i;
        plants[i] = (plant){atof(of[0]), atof(of[1]), atof(of[2]), atof(of[3]), atof(of[4]), atof(of[5]), atof(of[6]), 0, 0, 0, 0};
        most[i] = atof(of[7]);
        plants[i].step = atof(of[8]) / COUNTS;
    }
    as_new();
    for (int i = 0; i < CLIENTS; i++) clients[i].fd = -1;
    struct sockaddr_un at = {.sun_family = AF_UNIX};
    strncpy(at.sun_path, argv[1], sizeof at.sun_path - 1);
    const int door = socket(AF_UNIX, SOCK_SEQPACKET, 0);
    if (door < 0 || bind(door, (struct sockaddr *)&at, sizeof at) || listen(door, CLIENTS)) return 4;
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    began_ns = (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
    printf("ready\n");
    fflush(stdout);
    for (;;) {
        struct pollfd all[2 + CLIENTS] = {{0, POLLIN, 0}, {door, POLLIN, 0}};
        for (int i = 0; i < CLIENTS; i++) all[2 + i] = (struct pollfd){clients[i].fd, POLLIN, 0};
        poll(all, 2 + CLIENTS, manual ? -1 : 1);
        const uint64_t now = manual ? at_us : real_us();
        if (noted && now > at_us + 2000u) fprintf(noted, "b %llu %llu\n", instant(now), (unsigned long long)(now - at_us));
        advance(now);
        if (all[0].revents && !take_orders()) return 0;
        for (int i = 0; i < CLIENTS; i++) {
            if (!all[2 + i].revents) continue;
            static rpc_request r;
            static rpc_reply a;
            if (recv(clients[i].fd, &r, sizeof r, 0) < RPC_ASKED) {
                leave(i);
                continue;
            }
            asked(i, &r, &a);
            if (send(clients[i].fd, &a, RPC_ANSWERED + a.size, MSG_NOSIGNAL) < 0) leave(i);
        }
        if (all[1].revents) {
            int free = 0;
            while (free < CLIENTS && clients[free].fd >= 0) free++;
            const int fd = accept(door, NULL, NULL);
            if (free == CLIENTS) close(fd);
            else clients[free] = (client){.fd = fd};
        }
    }
}
