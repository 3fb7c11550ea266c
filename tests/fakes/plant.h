/* One axis of a mechanism for fake devices: mass, damping, dry friction, an encoder with steps, and a hand on a spring.
 *
 *     m a = f - b v - friction + k (r(t) - x),   r(t) = A sin(2 pi n t)
 *
 * Dry friction takes at most c: where it can hold the mechanism for a step, it does. So it never turns a motion back.
 */
#ifndef PLANT_H
#define PLANT_H
#include <math.h>

typedef struct {
    double m, b, c, step;     /* kg, N s/m, N, m */
    double k, amplitude, frequency; /* of the hand: N/m, m, Hz; k 0 for none */
    double x, v, t, work;     /* m, m/s, s, J of the force f since the beginning */
} plant;

static void plant_advance(plant *p, double f, double dt) {
    const double r = p->amplitude * sin(6.283185307179586 * p->frequency * p->t);
    const double drive = f + p->k * (r - p->x);
    double v = (p->v + dt * drive / p->m) / (1.0 + dt * p->b / p->m + dt * dt * p->k / p->m);
    const double most = dt * p->c / p->m;
    v = v > most ? v - most : v < -most ? v + most : 0.0;
    p->v = v;
    p->x += dt * v;
    p->work += f * dt * v;
    p->t += dt;
}

static double plant_seen(const plant *p) { return p->step > 0.0 ? p->step * floor(p->x / p->step + 0.5) : p->x; }
#endif
