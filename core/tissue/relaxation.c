#include "tissue/relaxation.h"

#include <math.h>
#include <stdbool.h>

relaxation_fault relaxation_check(int count, const relaxation_term *terms) {
    double sum = 0.0;
    for (int i = 0; i < count; i++) {
        sum += terms[i].weight;
        if (!(terms[i].weight > 0.0)) return (relaxation_fault){i, "weight", "not above 0: the stress would grow under a held strain"};
        if (!(terms[i].time > 0.0) || isinf(terms[i].time)) return (relaxation_fault){i, "time", "not a time above 0 s: the stress would not decay"};
        if (!(sum < 1.0)) return (relaxation_fault){i, "weight", "the weights up to here add up to 1 or more: no elastic stress would be left; lower them"};
        for (int k = 0; k < i; k++)
            if (terms[k].time == terms[i].time) return (relaxation_fault){i, "time", "the same as that of an earlier term: add the weights and give one term"};
    }
    return (relaxation_fault){0, NULL, NULL};
}

double relaxation_at(int count, const relaxation_term *terms, double t) {
    double stress = 1.0;
    for (int i = 0; i < count; i++) stress += terms[i].weight * expm1(-t / terms[i].time);
    return stress;
}

/* Returns s times the Laplace transform of the relaxation function, at s = -rate. */
static double modulus_at(int count, const relaxation_term *terms, double rate) {
    double sum = 1.0;
    for (int i = 0; i < count; i++) sum += terms[i].weight / (rate * terms[i].time - 1.0);
    return sum;
}

/* Finds the creep rate between two adjacent relaxation rates (the lower one may be 0). Between them, the modulus falls from infinity (or, if the lower rate is
   0, from its long-term value) to minus infinity. */
static double creep_rate(int count, const relaxation_term *terms, double low, double high) {
    for (double middle = 0.5 * (low + high); low < middle && middle < high; middle = 0.5 * (low + high)) {
        if (modulus_at(count, terms, middle) > 0.0) low = middle;
        else high = middle;
    }
    return low;
}

/* The creep function J and the relaxation function G satisfy s^2 G~(s) J~(s) = 1. M(s) = s G~(s) is a rational function with simple poles at -1 / relaxation
   times. The zeros of M, one between any two adjacent poles, give the times of J; the residues of 1 / (s M(s)) there, -1 / (s M'(s)), give its compliances. */
trocar_status creep_from_relaxation(int count, const relaxation_term *terms, creep_series *creep, trocar_error *why) {
    relaxation_term sorted[MAX_RELAXATION];
    relaxation_fault wrong = relaxation_check(count, terms);
    if (wrong.key) return fail(why, TROCAR_BAD_INPUT, "relaxation[%d].%s: %s", wrong.term, wrong.key, wrong.words);
    for (int i = 0; i < count; i++) { /* longest time first, so that the rates ascend */
        int k = i;
        for (; k > 0 && sorted[k - 1].time < terms[i].time; k--) sorted[k] = sorted[k - 1];
        sorted[k] = terms[i];
    }
    *creep = (creep_series){.count = count};
    for (int i = 0; i < count; i++) {
        double rate = creep_rate(count, sorted, i > 0 ? 1.0 / sorted[i - 1].time : 0.0, 1.0 / sorted[i].time), slope = 0.0;
        for (int k = 0; k < count; k++) slope += sorted[k].weight * sorted[k].time / pow(rate * sorted[k].time - 1.0, 2);
        creep->time[count - 1 - i] = 1.0 / rate;
        creep->compliance[count - 1 - i] = 1.0 / (rate * slope);
    }
    return TROCAR_OK;
}
