/* A library of the ABI of the Force Dimension SDK, with delta robots behind it, in real time, and failures to order.
 *
 * The prototypes are those of dhdc.h and drdc.h as public repositories have them (tests/devices/force_dimension/
 * test_abi.py names them); nothing of these files is copied. Two devices live in the file that FAKE_DHD names, so that
 * they outlive the process that has opened them, and a test can look at them and give orders from another one. Nobody
 * has to run them: each call brings them up to the present, with the torques that the motors held meanwhile, and the
 * watchdog, in between.
 *
 * A device is a mass at the tip of a delta robot: m a = J^-T t - b v - friction + hand, the hand a spring to A sin(wt).
 * Its encoders and motors have steps. Of the SDK's frame X is the linkage's z less MIDDLE, Y its x, and Z its y.
 *
 * Orders, one a line (fake_dhd_order): see `obey` below. The log that the order `log` begins has a line for each change,
 * with its instant (CLOCK_MONOTONIC, ns), whichever process made it: "m AT F..." (what the motors exert, as the force F
 * that their torques stood for when they came, N), "t AT F..." (torques that came), "w AT STEPS" (the watchdog, set) and
 * "o AT WORDS" (the order `note`).
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { DEVICES = 2, STATUS = 17, TIMEGUARD = 1, SATURATED = 2 };
enum { NO_ERROR, ERROR, COM, NO_DEVICE = 5, NOT_AVAILABLE = 6, GEOMETRY = 8, EXPERT = 9, IN_USE = 20, INVALID = 21 };
enum { BUTTON = 1, VELOCITY = 2, WATCHDOG = 3, SOFTWARE = 4 };

static const double SHOULDER = 0.05, UPPER = 0.12, ROD = 0.20, MIDDLE = 0.16; /* m; base 0.08 less platform 0.03 */
static const double COUNT = 6.283185307179586 / 65536.0;                    /* rad */
static const double STOP = 0.055;                                            /* m, of each axis */
static const double BRAKING = 8.0;                                           /* N s/m, of motors in short circuit */
static const int64_t STEP_NS = 50000, FORGOTTEN_NS = 300000000;

typedef struct {
    int32_t present, unplugged, uncalibrated, no_watchdog, com, stuck, rotated, transposed, lying, deaf;
    int32_t pressed, wrist, skewed; /* wrist: 0 none, 1 without motors, 2 with */
    int32_t owner, forces, braked, cause, gravity, guard_us, saturations, watchdogs, reads, sets, trip_us, stall_ms;
    int32_t watchdog, enc[3];
    int64_t now, read_at, set_at, manual; /* manual: of the first device, the time where a test makes it */
    double m, b, c, k, amplitude[3], frequency, most, fastest; /* hand's spring k, motors' N m, threshold m/s */
    double x[3], v[3], t[3], q[3], work, phase;
    double turn[4], wt[3]; /* of the wrist: w, x, y, z, and the torques of its joints, N m */
    double f[3], noted[3]; /* the force that t stood for, and what the log has of it, N */
    double scale, unit; /* of places and J, 1/m: as ordered, and since the last reading */
    char log[256];
} device;

static struct { char path[512]; int fd; device *all; } file = {"", -1, NULL};
static __thread int last_error;
static int expert, default_id;
static struct { char path[256]; int fd; } noting = {"", -1};

static int64_t now_ns(void) {
    if (file.all && file.all->manual) return file.all->manual;
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* --- kinematics, in the linkage's own frame */

static int angles(const double p[3], double q[3]) {
    for (int i = 0; i < 3; i++) {
        const double around = 2.0 * M_PI * i / 3.0;
        const double r[3] = {p[0] - SHOULDER * cos(around), p[1] - SHOULDER * sin(around), p[2]};
        const double a = r[0] * cos(around) + r[1] * sin(around), b = r[2];
        const double k = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + UPPER * UPPER - ROD * ROD) / (2.0 * UPPER);
        const double left = a * a + b * b - k * k;
        if (left <= 0.0) return -1;
        q[i] = atan2(b * k - a * sqrt(left), a * k + b * sqrt(left));
    }
    return 0;
}

/* rows of dq/dp */
static void by_tip(const double p[3], const double q[3], double rows[3][3]) {
    for (int i = 0; i < 3; i++) {
        const double around = 2.0 * M_PI * i / 3.0, out[3] = {cos(around), sin(around), 0.0};
        const double elbow[3] = {(SHOULDER + UPPER * cos(q[i])) * out[0], (SHOULDER + UPPER * cos(q[i])) * out[1],
                                 UPPER * sin(q[i])};
        double lever = 0.0, rod[3];
        for (int j = 0; j < 3; j++) {
            rod[j] = p[j] - elbow[j];
            lever += rod[j] * (j == 2 ? UPPER * cos(q[i]) : -UPPER * sin(q[i]) * out[j]);
        }
        for (int j = 0; j < 3; j++) rows[i][j] = rod[j] / lever;
    }
}

static int inverse(double a[3][3], double m[3][3]) {
    double det = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            m[j][i] = a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3] -
                      a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3];
    for (int j = 0; j < 3; j++) det += a[0][j] * m[j][0];
    if (fabs(det) < 1e-12) return -1;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m[i][j] /= det;
    return 0;
}

/* the tip of given angles: where three spheres of the rods' length meet, by Newton's method from a place near it */
static int tip(const double q[3], double p[3]) {
    p[0] = p[1] = 0.0, p[2] = MIDDLE;
    for (int round = 0; round < 50; round++) {
        double f[3], a[3][3], back[3][3], size = 0.0;
        for (int i = 0; i < 3; i++) {
            const double around = 2.0 * M_PI * i / 3.0, R = SHOULDER + UPPER * cos(q[i]);
            const double rod[3] = {p[0] - R * cos(around), p[1] - R * sin(around), p[2] - UPPER * sin(q[i])};
            f[i] = rod[0] * rod[0] + rod[1] * rod[1] + rod[2] * rod[2] - ROD * ROD;
            for (int j = 0; j < 3; j++) a[i][j] = 2.0 * rod[j];
        }
        if (inverse(a, back)) return -1;
        for (int i = 0; i < 3; i++) {
            const double step = back[i][0] * f[0] + back[i][1] * f[1] + back[i][2] * f[2];
            p[i] -= step, size += fabs(step);
        }
        if (size < 1e-13) return 0;
    }
    return -1;
}

static void to_sdk(const double p[3], double x[3]) { x[0] = p[2] - MIDDLE, x[1] = p[0], x[2] = p[1]; }
static void from_sdk(const double x[3], double p[3]) { p[2] = x[0] + MIDDLE, p[0] = x[1], p[1] = x[2]; }

/* dx/dq in the SDK's frame */
static int jacobian(const double q[3], double J[3][3]) {
    double p[3], rows[3][3], own[3][3];
    if (tip(q, p)) return -1;
    by_tip(p, q, rows);
    if (inverse(rows, own)) return -1;
    for (int j = 0; j < 3; j++) J[0][j] = own[2][j], J[1][j] = own[0][j], J[2][j] = own[1][j];
    return 0;
}

/* the force that torques stand for at angles q, in the SDK's frame */
static void force_of(const double p[3], const double q[3], const double t[3], double f[3]) {
    double rows[3][3], own[3] = {0};
    by_tip(p, q, rows);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) own[j] += rows[i][j] * t[i];
    f[0] = own[2], f[1] = own[0], f[2] = own[1];
}

/* --- the log */

static void note(const device *d, const char *format, ...) {
    if (!*d->log) return;
    if (strcmp(d->log, noting.path)) {
        if (noting.fd >= 0) close(noting.fd);
        noting.fd = open(d->log, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
        snprintf(noting.path, sizeof noting.path, "%s", d->log);
    }
    va_list rest;
    va_start(rest, format);
    vdprintf(noting.fd, format, rest); /* a line at once, so that a process that is killed leaves none in half */
    va_end(rest);
}

/* What the motors exert from d->now on. A process that is killed before this leaves it to the next one. */
static void note_motors(device *d) {
    double f[3];
    int changed = 0;
    for (int i = 0; i < 3; i++) f[i] = d->forces ? d->f[i] : 0.0, changed |= f[i] != d->noted[i];
    if (!changed) return;
    note(d, "m %lld %.17g %.17g %.17g\n", (long long)d->now, f[0], f[1], f[2]);
    memcpy(d->noted, f, sizeof f);
}

/* --- the devices in time */

static void advance(device *d, double dt, bool on) {
    double p[3], q[3], rows[3][3], way = 0.0, speed = 0.0;
    from_sdk(d->x, p);
    if (angles(p, q)) return;
    by_tip(p, q, rows);
    double own[3] = {0};
    for (int i = 0; i < 3 && on; i++)
        for (int j = 0; j < 3; j++) own[j] += rows[i][j] * d->t[i];
    const double F[3] = {own[2], own[0], own[1]}, b = d->b + (d->braked ? BRAKING : 0.0);
    for (int i = 0; i < 3; i++) {
        const double r = d->amplitude[i] * sin(d->phase);
        d->v[i] = (d->v[i] + dt * (F[i] + d->k * (r - d->x[i])) / d->m) / (1.0 + dt * b / d->m + dt * dt * d->k / d->m);
        speed += d->v[i] * d->v[i];
    }
    speed = sqrt(speed);
    const double burnt = dt * d->c / d->m, left = speed > burnt ? 1.0 - burnt / speed : 0.0;
    for (int i = 0; i < 3; i++) {
        d->v[i] *= left;
        d->x[i] += dt * d->v[i];
        if (fabs(d->x[i]) > STOP) d->x[i] = copysign(STOP, d->x[i]), d->v[i] = 0.0;
    }
    from_sdk(d->x, p);
    if (angles(p, d->q) == 0 && on)
        for (int i = 0; i < 3; i++) way += d->t[i] * (d->q[i] - q[i]);
    d->work += way;
    d->phase += 6.283185307179586 * d->frequency * dt;
    if (d->fastest > 0.0 && speed > d->fastest && d->forces) d->forces = 0, d->braked = 1, d->cause = VELOCITY;
}

static void catch_up(device *d, int64_t to) {
    note_motors(d);
    if (to - d->now > FORGOTTEN_NS && !d->owner && !d->forces) d->now = to; /* nobody had it open: it stood still */
    while (d->now < to) {
        int64_t end = to - d->now > STEP_NS ? d->now + STEP_NS : to;
        const int64_t over = d->set_at + 125000 * (int64_t)d->watchdog;
        if (d->forces && d->watchdog && over > d->now && over < end) end = over;
        if (d->forces && d->watchdog && over <= d->now)
            d->forces = 0, d->braked = !d->deaf, d->cause = WATCHDOG, d->watchdogs++;
        advance(d, 1e-9 * (double)(end - d->now), d->forces);
        note_motors(d); /* of the velocity threshold, a step early at most; of the watchdog exactly */
        d->now = end;
    }
}

static void spin(int64_t ns) {
    if (file.all->manual) {
        file.all->manual += ns;
        return;
    }
    const int64_t end = now_ns() + ns;
    while (now_ns() < end) {}
}

static int fail(int error) { return last_error = error, -1; }

static device *enter(int id) {
    const char *path = getenv("FAKE_DHD");
    if (path && strcmp(path, file.path)) {
        if (file.fd >= 0) munmap(file.all, DEVICES * sizeof(device)), close(file.fd);
        file.fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
        snprintf(file.path, sizeof file.path, "%s", path);
        if (file.fd < 0 || ftruncate(file.fd, DEVICES * sizeof(device))) return NULL;
        file.all = mmap(NULL, DEVICES * sizeof(device), PROT_READ | PROT_WRITE, MAP_SHARED, file.fd, 0);
    }
    if (!path || file.fd < 0 || file.all == MAP_FAILED) return NULL;
    if (id == -1) id = default_id;
    if (id < 0 || id >= DEVICES) return NULL;
    flock(file.fd, LOCK_EX);
    device *d = file.all + id;
    if (d->m == 0.0) {
        *d = (device){.present = id == 0, .com = 1, .guard_us = 500, .trip_us = 20, .gravity = 1, .braked = 1,
                      .m = 0.2, .b = 0.5, .most = 1.0, .fastest = 3.0, .now = now_ns(), .scale = 1.0, .unit = 1.0,
                      .turn = {1.0}};
        double p[3] = {0.0, 0.0, MIDDLE};
        angles(p, d->q);
    }
    catch_up(d, now_ns());
    return d;
}

static int leave(int result) {
    flock(file.fd, LOCK_UN);
    return result;
}

static bool gone(const device *d) { return !d->present || d->unplugged; }

/* one exchange over the bus: what the device does of it, it does in the middle */
static device *exchange(int id) {
    device *d = enter(id);
    if (!d) return fail(INVALID), NULL;
    if (d->stall_ms) {
        if (!file.all->manual) usleep(1000u * (unsigned)d->stall_ms);
        else spin(1000000LL * d->stall_ms);
        d->stall_ms = 0;
    }
    spin(500LL * d->trip_us);
    catch_up(d, now_ns());
    if (gone(d) || d->owner != getpid()) return leave(fail(COM)), NULL;
    return d;
}

static int sent(const device *d) {
    spin(500LL * d->trip_us);
    return leave(0);
}

/* --- for tests */

static int obey(device *d, const char *line) {
    double a, b, c, e;
    int n;
    if (sscanf(line, "plant %lf %lf %lf", &a, &b, &c) == 3) d->m = a, d->b = b, d->c = c; /* kg, N s/m, N */
    else if (sscanf(line, "hand %lf %lf", &a, &b) == 2) d->k = a, d->frequency = b; /* N/m, Hz */
    else if (sscanf(line, "to %lf %lf %lf", &a, &b, &c) == 3) d->amplitude[0] = a, d->amplitude[1] = b, d->amplitude[2] = c;
    else if (sscanf(line, "speed %lf %lf %lf", &a, &b, &c) == 3) d->v[0] = a, d->v[1] = b, d->v[2] = c;
    else if (sscanf(line, "present %d", &n) == 1) d->present = n;
    else if (sscanf(line, "unplugged %d", &n) == 1) { if ((d->unplugged = n)) d->forces = 0, d->braked = 1; }
    else if (sscanf(line, "cut %d", &n) == 1) d->unplugged = n;          /* likewise, but the device has not seen it */
    else if (!strcmp(line, "reset"))                                     /* its power was away: who has it open has not */
        d->forces = d->owner = d->watchdog = 0, d->braked = d->uncalibrated = d->gravity = 1, d->guard_us = 500;
    else if (sscanf(line, "owner %d", &n) == 1) d->owner = n;            /* the process that has it open */
    else if (sscanf(line, "uncalibrated %d", &n) == 1) d->uncalibrated = n;
    else if (sscanf(line, "no_watchdog %d", &n) == 1) d->no_watchdog = n;
    else if (sscanf(line, "asynchronous %d", &n) == 1) d->com = n ? 3 : 1; /* a mode that cannot be left */
    else if (sscanf(line, "stuck %d", &n) == 1) d->stuck = n;            /* all readings are of the past */
    else if (sscanf(line, "rotated %d", &n) == 1) d->rotated = n;        /* positions are in a turned frame */
    else if (sscanf(line, "transposed %d", &n) == 1) d->transposed = n;  /* the Jacobian is another one than stated */
    else if (sscanf(line, "scale %lf", &a) == 1) d->scale = a;           /* from the next reading on places and J have another unit */
    else if (sscanf(line, "lying %d", &n) == 1) d->lying = n;            /* torques of the wrong sign */
    else if (sscanf(line, "pressed %d", &n) == 1) d->pressed = n;        /* its buttons, bit by bit */
    else if (sscanf(line, "wrist %d", &n) == 1) d->wrist = n;
    else if (sscanf(line, "skewed %d", &n) == 1) d->skewed = n;          /* its frame is no rotation */
    else if (sscanf(line, "turned %lf %lf %lf %lf", &a, &b, &c, &e) == 4) d->turn[0] = a, d->turn[1] = b, d->turn[2] = c, d->turn[3] = e;
    else if (sscanf(line, "twisted %lf", &a) == 1) d->wt[0] = d->wt[1] = d->wt[2] = a; /* N m, left by another program */
    else if (sscanf(line, "deaf %d", &n) == 1) d->deaf = n, d->watchdog = n ? 0 : d->watchdog;
    else if (sscanf(line, "most %lf", &a) == 1) d->most = a;             /* N m, of each motor */
    else if (sscanf(line, "fastest %lf", &a) == 1) d->fastest = a;       /* m/s, its velocity threshold */
    else if (sscanf(line, "trip %d", &n) == 1) d->trip_us = n;
    else if (sscanf(line, "stall %d", &n) == 1) d->stall_ms = n;         /* ms, of the next exchange */
    else if (!strcmp(line, "button")) d->forces = 0, d->braked = 1, d->cause = BUTTON;
    else if (!strncmp(line, "log ", 4)) snprintf(d->log, sizeof d->log, "%s", line + 4); /* PATH: write down from now on */
    else if (!strncmp(line, "note ", 5)) note(d, "o %lld %s\n", (long long)d->now, line + 5);
    else return -1;
    return 0;
}

/* Orders of one instant, a line each; -1 where one is not known. */
int fake_dhd_order(int id, const char *lines) {
    device *d = enter(id);
    if (!d) return -1;
    char all[512], *rest = all;
    snprintf(all, sizeof all, "%s", lines);
    int done = 0;
    for (char *line; !done && (line = strsep(&rest, "\n"));) done = obey(d, line);
    note_motors(d);
    return leave(done);
}

/* the force that the torques stand for which act, N */
int fake_dhd_force(int id, double f[3]) {
    device *d = enter(id);
    if (!d) return -1;
    for (int i = 0; i < 3; i++) f[i] = d->forces ? d->f[i] : 0.0;
    return leave(0);
}

/* its place (m), the torques that act (N m), the work of its motors (J), and counts */
int fake_dhd_ask(int id, double out[16]) {
    device *d = enter(id);
    if (!d) return -1;
    for (int i = 0; i < 3; i++) out[i] = d->x[i], out[3 + i] = d->forces ? d->t[i] : 0.0;
    const double rest[] = {d->work, d->watchdogs, d->reads, d->sets, d->forces, d->braked, d->gravity, d->guard_us,
                           d->watchdog, d->com};
    memcpy(out + 6, rest, sizeof rest);
    return leave(0);
}

/* the torques of its wrist's joints, N m */
int fake_dhd_wrist(int id, double t[3]) {
    device *d = enter(id);
    if (!d) return -1;
    memcpy(t, d->wt, sizeof d->wt);
    return leave(0);
}

/* the time of the devices, ns; from the first call on with one of its own it is the test's, and goes on by exchanges */
int64_t fake_dhd_time(int64_t to) {
    if (!enter(0)) return -1;
    for (int id = 0; id < DEVICES && to && !file.all->manual; id++) file.all[id].now = file.all[id].set_at = to;
    if (to) file.all->manual = to;
    leave(0);
    return now_ns();
}

void fake_dhd_forget(void) {
    if (file.fd >= 0) munmap(file.all, DEVICES * sizeof(device)), close(file.fd);
    file.all = NULL;
    if (noting.fd >= 0) close(noting.fd);
    file.fd = noting.fd = -1, file.path[0] = noting.path[0] = 0, expert = 0;
}

/* --- the SDK */

const char *dhdErrorGetLastStr(void) {
    switch (last_error) {
        case NO_ERROR: return "no error";
        case COM: return "communication error";
        case NO_DEVICE: return "no device found";
        case NOT_AVAILABLE: return "not available";
        case GEOMETRY: return "geometry error";
        case EXPERT: return "expert mode is disabled";
        case IN_USE: return "device already in use";
        case INVALID: return "invalid argument";
        default: return "error";
    }
}

void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision) {
    *major = 3, *minor = 17, *release = 0, *revision = 0;
}

int dhdGetDeviceCount(void) {
    int count = 0;
    for (int id = 0; id < DEVICES; id++) {
        device *d = enter(id);
        if (d) count += !gone(d), leave(0);
    }
    return count;
}

int drdOpenID(char id) {
    device *d = enter(id);
    if (!d) return fail(NO_DEVICE);
    if (gone(d)) return leave(fail(NO_DEVICE));
    if (d->owner && d->owner != getpid() && (kill(d->owner, 0) == 0 || errno == EPERM)) return leave(fail(IN_USE));
    d->owner = getpid(), d->forces = 0, d->braked = 1, d->cause = SOFTWARE, d->guard_us = 500, d->gravity = 1;
    if (d->com != 3) d->com = 1;
    return default_id = id, leave(id);
}

int drdClose(char id) {
    device *d = enter(id);
    if (!d) return fail(INVALID);
    if (d->owner != getpid()) return leave(fail(INVALID));
    d->owner = 0; /* its forces last on until the watchdog ends them: dhdStop is another call */
    return leave(0);
}

bool drdIsInitialized(char id) {
    device *d = enter(id);
    if (!d) return false;
    const bool is = !d->uncalibrated;
    leave(0);
    return is;
}

int dhdGetSerialNumber(unsigned short *sn, char id) {
    if (!exchange(id)) return -1;
    *sn = (unsigned short)(7001 + id);
    return leave(0);
}

static int wrist_of(char id) {
    device *d = enter(id);
    if (!d) return -1;
    return leave(d->wrist);
}

const char *dhdGetSystemName(char id) {
    const char *names[] = {"omega.3", "omega.6", "sigma.7"};
    const int wrist = wrist_of(id);
    return wrist < 0 ? NULL : names[wrist];
}

int dhdGetSystemType(char id) {
    const int types[] = {33, 34, 104}, wrist = wrist_of(id);
    return wrist < 0 ? fail(INVALID) : types[wrist];
}

bool dhdHasWrist(char id) { return wrist_of(id) > 0; }
bool dhdHasActiveWrist(char id) { return wrist_of(id) > 1; }

int dhdGetOrientationFrame(double matrix[3][3], char id) {
    device *d = exchange(id);
    if (!d) return -1;
    const double *q = d->turn, s = d->skewed ? 1.1 : 1.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double cross = 0.0;
            if (i != j) cross = ((j - i + 3) % 3 == 1 ? -1.0 : 1.0) * q[1 + (3 - i - j)]; /* the third axis */
            matrix[i][j] = d->wrist ? 2.0 * (q[1 + i] * q[1 + j] + q[0] * cross) : 0.0;
        }
    for (int i = 0; i < 3; i++) matrix[i][i] += d->wrist ? 2.0 * q[0] * q[0] - 1.0 : 1.0, matrix[i][i] *= s;
    return sent(d);
}

int dhdSetWristJointTorques(double t0, double t1, double t2, char id) {
    if (!expert) return fail(EXPERT);
    device *d = exchange(id);
    if (!d) return -1;
    if (d->wrist < 2) return leave(fail(NOT_AVAILABLE));
    d->wt[0] = t0, d->wt[1] = t1, d->wt[2] = t2;
    return sent(d);
}
int dhdEnableExpertMode(void) { return expert = 1, 0; }

#define SETTER(name, type, needs_expert, ...)                    \
    int name(type value, char id) {                               \
        if (needs_expert && !expert) return fail(EXPERT);         \
        device *d = exchange(id);                                 \
        if (!d) return -1;                                        \
        __VA_ARGS__;                                                  \
        return sent(d);                                           \
    }
SETTER(dhdSetComMode, int, 1, if (d->com != 3) d->com = value)
SETTER(dhdSetTimeGuard, int, 1, d->guard_us = value < 0 ? 500 : value)
SETTER(dhdSetGravityCompensation, int, 0, d->gravity = value)
SETTER(dhdSetBrakes, int, 0, d->braked = value)
SETTER(dhdEnableForce, unsigned char, 0, d->forces = value; if (value) d->braked = 0, d->cause = 0, d->set_at = d->now)
SETTER(dhdSetWatchdog, unsigned char, 1, if (d->no_watchdog) return leave(fail(NOT_AVAILABLE));
       d->watchdog = d->deaf ? 0 : value; note(d, "w %lld %d\n", (long long)d->now, d->watchdog))

int dhdGetComMode(char id) {
    device *d = exchange(id);
    if (!d) return -1;
    return leave(d->com);
}

int dhdGetVelocityThreshold(unsigned *value, char id) {
    if (!expert) return fail(EXPERT);
    device *d = exchange(id);
    if (!d) return -1;
    *value = (unsigned)(1000.0 * d->fastest);
    return leave(0);
}

int dhdGetStatus(int status[STATUS], char id) {
    device *d = exchange(id);
    if (!d) return -1;
    memset(status, 0, STATUS * sizeof *status);
    status[0] = status[1] = status[2] = 1, status[3] = d->uncalibrated, status[5] = d->forces, status[6] = d->braked;
    status[7] = d->forces, status[10] = d->gravity, status[11] = d->guard_us > 0, status[14] = d->cause;
    return sent(d);
}

int dhdGetDeltaEncoders(int *enc0, int *enc1, int *enc2, char id) {
    if (!expert) return fail(EXPERT);
    device *d = enter(id);
    if (!d) return fail(INVALID);
    const bool old = d->stuck || (d->guard_us && d->now - d->read_at < 1000LL * d->guard_us);
    leave(0);
    if (!old) {
        if (!(d = exchange(id))) return -1;
        for (int i = 0; i < 3; i++) d->enc[i] = (int)lround(d->q[i] / COUNT);
        d->read_at = d->now, d->reads++, d->unit = d->scale;
        sent(d);
    } else if (gone(d)) {
        return fail(COM);
    }
    *enc0 = d->enc[0], *enc1 = d->enc[1], *enc2 = d->enc[2];
    return old ? TIMEGUARD : 0;
}

int dhdDeltaEncodersToJointAngles(int enc0, int enc1, int enc2, double *j0, double *j1, double *j2, char id) {
    (void)id;
    *j0 = COUNT * enc0, *j1 = COUNT * enc1, *j2 = COUNT * enc2;
    return 0;
}

int dhdDeltaEncoderToPosition(int enc0, int enc1, int enc2, double *px, double *py, double *pz, char id) {
    const double q[3] = {COUNT * enc0, COUNT * enc1, COUNT * enc2};
    double p[3], x[3];
    if (!expert) return fail(EXPERT);
    if (tip(q, p)) return fail(GEOMETRY);
    to_sdk(p, x);
    const double scale = file.all[(int)id].unit;
    *px = scale * x[0], *py = scale * x[1], *pz = scale * x[2];
    return 0;
}

int dhdDeltaPositionToEncoder(double px, double py, double pz, int *enc0, int *enc1, int *enc2, char id) {
    const double scale = file.all[(int)id].unit, x[3] = {px / scale, py / scale, pz / scale};
    double p[3], q[3];
    if (!expert) return fail(EXPERT);
    from_sdk(x, p);
    if (angles(p, q)) return fail(GEOMETRY);
    *enc0 = (int)lround(q[0] / COUNT), *enc1 = (int)lround(q[1] / COUNT), *enc2 = (int)lround(q[2] / COUNT);
    return 0;
}

int dhdDeltaJointAnglesToJacobian(double j0, double j1, double j2, double jcb[3][3], char id) {
    const double q[3] = {j0, j1, j2};
    if (!expert) return fail(EXPERT);
    if (jacobian(q, jcb)) return fail(GEOMETRY);
    device *d = enter(id);
    if (!d) return fail(INVALID);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) jcb[i][j] *= d->unit;
    for (int i = 0; i < 3 && d->transposed; i++)
        for (int j = 0; j < i; j++) {
            const double other = jcb[i][j];
            jcb[i][j] = jcb[j][i], jcb[j][i] = other;
        }
    return leave(0);
}

int dhdDeltaJointTorquesExtrema(double j0, double j1, double j2, double minq[3], double maxq[3], char id) {
    (void)j0, (void)j1, (void)j2;
    device *d = enter(id);
    if (!d) return fail(INVALID);
    for (int i = 0; i < 3; i++) minq[i] = -d->most, maxq[i] = d->most;
    return leave(0);
}

int dhdSetDeltaJointTorques(double t0, double t1, double t2, char id) {
    if (!expert) return fail(EXPERT);
    device *d = exchange(id);
    if (!d) return -1;
    const double t[3] = {t0, t1, t2};
    double scale = 1.0;
    for (int i = 0; i < 3; i++)
        if (fabs(t[i]) * scale > d->most * (1.0 + 1e-12)) scale = d->most / fabs(t[i]);
    const double step = d->most / 32768.0; /* of a motor's command */
    for (int i = 0; i < 3; i++) d->t[i] = step * round(t[i] * scale / step) * (d->lying ? -1.0 : 1.0);
    double p[3];
    const double q[3] = {COUNT * d->enc[0], COUNT * d->enc[1], COUNT * d->enc[2]}; /* of which they were computed */
    if (tip(q, p) == 0) force_of(p, q, d->t, d->f);
    d->set_at = d->now, d->sets++;
    note(d, "t %lld %.17g %.17g %.17g\n", (long long)d->now, d->f[0], d->f[1], d->f[2]);
    note_motors(d);
    sent(d);
    return scale < 1.0 ? (d->saturations++, SATURATED) : 0;
}

int dhdGetPosition(double *px, double *py, double *pz, char id) {
    int enc[3];
    double x[3];
    const int was = expert;
    expert = 1;
    const int read = dhdGetDeltaEncoders(enc, enc + 1, enc + 2, id);
    if (read < 0 || dhdDeltaEncoderToPosition(enc[0], enc[1], enc[2], x, x + 1, x + 2, id) < 0) return expert = was, -1;
    expert = was;
    const bool turned = file.all[(int)id].rotated;
    *px = turned ? 0.8 * x[0] - 0.6 * x[2] : x[0], *py = x[1], *pz = turned ? 0.6 * x[0] + 0.8 * x[2] + 0.001 : x[2];
    return read;
}

int dhdGetForce(double *fx, double *fy, double *fz, char id) {
    device *d = exchange(id);
    if (!d) return -1;
    const double none[3] = {0};
    double p[3], q[3], f[3];
    from_sdk(d->x, p);
    angles(p, q);
    force_of(p, q, d->forces ? d->t : none, f);
    *fx = f[0], *fy = f[1], *fz = f[2];
    return sent(d);
}

int dhdSetForce(double fx, double fy, double fz, char id) {
    int enc[3];
    double q[3], J[3][3], f[3] = {fx, fy, fz}, t[3] = {0};
    if (dhdGetDeltaEncoders(enc, enc + 1, enc + 2, id) < 0) return -1;
    for (int i = 0; i < 3; i++) q[i] = COUNT * enc[i];
    if (jacobian(q, J)) return fail(GEOMETRY);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) t[j] += J[i][j] * f[i];
    return dhdSetDeltaJointTorques(t[0], t[1], t[2], id);
}

unsigned dhdGetButtonMask(char id) {
    device *d = enter(id);
    if (!d) return 0;
    const unsigned mask = d->unplugged ? 0 : d->pressed;
    leave(0);
    return mask;
}

double dhdGetComFreq(char id) {
    device *d = enter(id);
    if (!d) return 0.0;
    const double trip = 1e-3 * d->trip_us;
    leave(0);
    return trip > 0.0 ? 0.5 / trip : 4.0; /* kHz */
}

int dhdStop(char id) {
    device *d = exchange(id);
    if (!d) return -1;
    d->forces = 0, d->braked = 1, d->cause = SOFTWARE;
    for (int i = 0; i < 3; i++) d->t[i] = 0.0;
    return sent(d);
}
