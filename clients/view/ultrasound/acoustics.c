#define _GNU_SOURCE
#include "view/ultrasound/acoustics.h"

#include <math.h>
#include <string.h>

const acoustics BONE = {-20, 15, 6.5}, STEEL = {-60, 0, 45.7}, TITANIUM = {-60, 0, 27.1};

/* The first entry whose word occurs in a region's name applies. The backscatter merely reproduces the textbook ranking of the organs (hyperechoic, hypoechoic,
   anechoic). */
static const struct {
    const char *word;
    acoustics is;
} TABLE[] = {
    {"transition", {-3, 0.5, 1.63}},
    {"prostate", {0, 0.5, 1.65}},
    {"gland", {0, 0.5, 1.65}},
    {"urethra", {-9, 0.5, 1.61}},
    {"seminal", {-8, 0.5, 1.62}},
    {"bladder", {1, 0.57, 1.68}},
    {"urine", {-60, 0.0022, 1.53}},
    {"rectal_content", {-40, 0.0022, 1.53}}, /* the probe's cover is filled with water or gel */
    {"rectum", {0, 0.57, 1.68}},
    {"fat", {6, 0.63, 1.39}},
    {"muscle", {-4, 0.96, 1.68}},
    {"levator", {-4, 0.96, 1.68}},
    {"obturator", {-4, 0.96, 1.68}},
    {"pelvic_floor", {-4, 0.96, 1.68}},
    {"perineum", {4, 0.57, 1.73}},
};

static const acoustics OTHER = {8, 0.5, 1.55};

acoustics acoustics_of(const trocar_model *model, int region) {
    if (isinf(trocar_model_material(model, region).cutting_force)) return BONE;
    for (size_t i = 0; i < sizeof TABLE / sizeof *TABLE; i++)
        if (strcasestr(trocar_model_region_name(model, region), TABLE[i].word)) return TABLE[i].is;
    return OTHER;
}

double reflection(double impedance, double other) { return fabs(impedance - other) / (impedance + other); }
