#include "scene/scene_table.h"

#include <float.h>
#include <stddef.h>
#include <string.h>

static const range POSITIVE = {DBL_MIN, DBL_MAX, "a number above 0"};
static const range NOT_NEGATIVE = {0, DBL_MAX, "a number of at least 0"};
static const range FACTOR = {1, DBL_MAX, "a number of at least 1"};
static const range FORCE = {0, INFINITY, "a number of at least 0, or .inf"};
static const range STIFFNESS = {DBL_MIN, INFINITY, "a number above 0, or .inf"};
static const range POISSON = {0, 0.49999999, "a number of at least 0 and below 0.5"};
const range ANY_NUMBER = {-DBL_MAX, DBL_MAX, "a number"};
static const range WEIGHT = {DBL_MIN, 1 - DBL_EPSILON, "a number above 0 and below 1"};
static const range ANGLE = {DBL_MIN, 1, "a number above 0, at most 1"};
static const range STIFFENING = {0, 10, "a number from 0 (linear) to 10"};
static const range DEVICE_DELAY = {0, 0.1, "a number from 0 to 0.1"};
static const range SCALE = {0.01, 10, "a number from 0.01 to 10"};
static const range BOW = {0, 0.01, "a number from 0 to 0.01"};
static const range SLOPE = {0, 1, "a number from 0 to 1"};
static const range RATE = {SCENE_MIN_RATE, SCENE_MAX_RATE, "a number from 250 to 10000"};
static const range SEGMENTS = {2, NEEDLE_MAX_SEGMENTS, "a whole number from 2 to 64"};
static const range NEEDLES = {1, MAX_NEEDLES, "a whole number from 1 to 32"};
_Static_assert(MAX_NEEDLES == 32, "the text of NEEDLES says so");
static const range HOLES = {1, 100, "a whole number from 1 to 100"};
static const range PASSES = {1, 100, "a whole number from 1 to 100"};
_Static_assert(NEEDLE_MAX_SEGMENTS == 64, "the text of SEGMENTS says so");

#define WORDS(function, ...)                                                       \
    static const char *function(int index) {                                       \
        static const char *const words[] = {__VA_ARGS__};                          \
        return index < (int)(sizeof words / sizeof *words) ? words[index] : NULL;  \
    }
WORDS(strain_word, [STRAIN_BY_PATCH] = "patch", [STRAIN_BY_NODE] = "node", [STRAIN_BY_ELEMENT] = "element")
WORDS(switch_word, "false", "true")
static const char *precision_word(int index) { return index < PRECISIONS ? inverse_precision_name((inverse_precision)index) : NULL; }
static const char *inverse_word(int index) { return index < INVERSE_CHOICES ? inverse_choice_name((inverse_choice)index) : NULL; }
static const char *profile_word(int index) { return device_profiles[index]; }

#define OF(member) offsetof(scene, member)
#define MATERIAL(member) offsetof(region_config, material.member)
#define MEMBRANE(member) offsetof(membrane_config, material.member)
#define SLIDES(member) offsetof(sliding_config, material.member)
#define CALCIFICATION(member) offsetof(calcification, member)
#define GUIDE(member) offsetof(guide_config, member)

const key_spec SCENE_TABLE[] = {
    {"mesh", "", FILE_PATH, OF(simulation.mesh_path), .required = true, .doc = "mesh file: MSH 2.2 or 4.1, or any format that Gmsh reads, if it is installed; relative to the scene file"},
    {"mesh_unit", "", LENGTH_UNIT, OF(simulation.mesh_unit), .doc = "of the mesh file's coordinates"},
    {"patient_to_mesh", "", TRANSFORM, OF(patient_to_mesh),
     .doc = "4 x 4, row by row: from the patient's coordinates (DICOM's LPS, mm) to the mesh's (m)"},
    {"rate_hz", "Hz", NUMBER, OF(rate_hz), &RATE, .doc = "of the haptic loop"},
    {"phase_lock", "", WORD, OF(phase_lock), .words = switch_word, .doc = "true: the loop's ticks begin just after the device's poses arrive"},

    {"regions[].name", "", NAME, offsetof(region_config, name), .list = REGIONS, .required = true, .doc = "a physical volume of the mesh"},
    {"regions[].part_of", "", NAME, offsetof(region_config, part_of), .list = REGIONS,
     .doc = "the region that names the organ, such as prostate for a zone of the gland; the organ consists of it and all its parts"},
    {"regions[].youngs_modulus", "Pa", NUMBER, MATERIAL(youngs_modulus), &POSITIVE, .live = true, .list = REGIONS, .doc = "of the tissue"},
    {"regions[].poisson_ratio", "", NUMBER, MATERIAL(poisson_ratio), &POISSON, .list = REGIONS, .doc = "of the tissue"},
    {"regions[].stiffening", "", NUMBER, MATERIAL(stiffening), &STIFFENING, .live = true, .list = REGIONS,
     .doc = "C20 / C10 of a Yeoh material, next to the needle; 0: the stress is linear in the strain"},
    {"regions[].cutting_force", "N", NUMBER, MATERIAL(cutting_force), &FORCE, .live = true, .list = REGIONS, .doc = "resistance at the tip; .inf is bone"},
    {"regions[].cutting_viscosity", "N s/m", NUMBER, MATERIAL(cutting_viscosity), &NOT_NEGATIVE, .live = true, .list = REGIONS,
     .doc = "added resistance per speed of the tip"},
    {"regions[].spreading_force", "N", NUMBER, MATERIAL(spreading_force), &NOT_NEGATIVE, .live = true, .list = REGIONS,
     .doc = "resistance at the tip that remains in an old track, where tissue is spread but not cut"},
    {"regions[].friction.static", "N/m", NUMBER, MATERIAL(friction_static), &NOT_NEGATIVE, .live = true, .list = REGIONS,
     .doc = "limit of the shaft's friction per length while it sticks"},
    {"regions[].friction.kinetic", "N/m", NUMBER, MATERIAL(friction_kinetic), &NOT_NEGATIVE, .live = true, .list = REGIONS,
     .doc = "friction per length once it slides; at most the static limit"},
    {"regions[].friction.viscous", "N s/m^2", NUMBER, MATERIAL(friction_viscous), &NOT_NEGATIVE, .live = true, .list = REGIONS,
     .doc = "added friction per length and sliding speed"},

    {"membranes[].name", "", NAME, offsetof(membrane_config, name), .list = MEMBRANES, .required = true, .doc = "a physical surface of the mesh"},
    {"membranes[].puncture_force", "N", NUMBER, offsetof(membrane_config, puncture_force), &FORCE, .live = true, .list = MEMBRANES, .required = true,
     .doc = "force of the tip at which the membrane breaks; no effect below the cutting_force of the tissue; .inf is bone"},
    {"membranes[].stiffness", "N/m", NUMBER, MEMBRANE(stiffness), &NOT_NEGATIVE, .live = true, .list = MEMBRANES,
     .doc = "in its plane: Young's modulus times thickness; 0: the surface resists only the tip"},
    {"membranes[].poisson_ratio", "", NUMBER, MEMBRANE(poisson_ratio), &POISSON, .list = MEMBRANES, .doc = "in its plane; matters only with a stiffness"},

    {"sliding[].name", "", NAME, offsetof(sliding_config, name), .list = SLIDING, .required = true,
     .doc = "a physical surface of the mesh, on which the regions on its two sides slide on each other but stay in contact"},
    {"sliding[].beside", "", NAME, offsetof(sliding_config, beside), .list = SLIDING,
     .doc = "the region on one side: only those faces of the surface slide; if omitted, all of its faces between two regions do"},
    {"sliding[].normal_stiffness", "N/m^3", NUMBER, SLIDES(normal), &POSITIVE, .list = SLIDING,
     .doc = "pressure between the two sides per distance by which they overlap or part"},
    {"sliding[].shear_stiffness", "N/m^3", NUMBER, SLIDES(shear), &NOT_NEGATIVE, .list = SLIDING,
     .doc = "shear stress per distance by which they slide, as from loose fascia; 0: nothing resists"},

    {"calcifications[].centre", "m", POINT, CALCIFICATION(centre), .list = CALCIFICATIONS, .required = true,
     .doc = "of a ball in the undeformed tissue, which is harder to cut"},
    {"calcifications[].radius", "m", NUMBER, CALCIFICATION(radius), &POSITIVE, .list = CALCIFICATIONS, .required = true, .doc = "of the ball"},
    {"calcifications[].cutting_factor", "", NUMBER, CALCIFICATION(cutting_factor), &FACTOR, .live = true, .list = CALCIFICATIONS,
     .doc = "cutting force in the ball, divided by the cutting_force of its region; where balls overlap, the largest counts"},

    {"relaxation[].weight", "", NUMBER, offsetof(relaxation_term, weight), &WEIGHT, .list = RELAXATION, .required = true,
     .doc = "part of the stress under constant strain that decays; sum below 1; the same in all regions"},
    {"relaxation[].time", "s", NUMBER, offsetof(relaxation_term, time), &POSITIVE, .list = RELAXATION, .required = true,
     .doc = "time in which this part falls to 1/e; all must differ"},

    {"fixed", "", NAMES, OF(simulation.fixed), .required = true, .doc = "physical groups held at zero displacement"},

    {"needle.length", "m", NUMBER, OF(simulation.needle.length), &POSITIVE, .doc = "from base to tip"},
    {"needle.outer_diameter", "m", NUMBER, OF(simulation.needle.outer_diameter), &POSITIVE, .doc = "18 G by default"},
    {"needle.inner_diameter", "m", NUMBER, OF(simulation.needle.inner_diameter), &NOT_NEGATIVE, .doc = "0 is solid"},
    {"needle.youngs_modulus", "Pa", NUMBER, OF(simulation.needle.youngs_modulus), &POSITIVE, .doc = "of the needle"},
    {"needle.poisson_ratio", "", NUMBER, OF(simulation.needle.poisson_ratio), &POISSON, .doc = "of the needle"},
    {"needle.bow", "", NUMBER, OF(simulation.needle.bow), &BOW, .doc = "of its length, by which its middle is off the line from base to tip"},
    {"needle.bevel_slope", "", NUMBER, OF(simulation.needle.bevel_slope), &SLOPE, .doc = "sideways cut per forward cut"},
    {"needle.segments", "", COUNT, OF(simulation.needle.segments), &SEGMENTS, .doc = "of its length"},

    {"needle.start.position", "m", POINT, OF(start.position), .required = true, .doc = "of the base before the insertion, outside the tissue"},
    {"needle.start.orientation", "", ROTATION, OF(start.orientation), .doc = "unit quaternion w, x, y, z that turns +z into the needle's direction"},
    {"needle.start.depth", "m", NUMBER, OF(start_depth), &POSITIVE, .doc = "depth to which scripted motions push the needle from there, at the same speed along the needle"},

    {"needles", "", COUNT, OF(simulation.needle_count), &NEEDLES, .doc = "number of identical needles in the same tissue"},

    {"seeds.length", "m", NUMBER, OF(simulation.seeds.length), &POSITIVE, .doc = "of a brachytherapy seed"},
    {"seeds.diameter", "m", NUMBER, OF(simulation.seeds.diameter), &POSITIVE, .doc = "less than the needle's outer diameter, or no seed can be dropped"},
    {"seeds.spacing", "m", NUMBER, OF(simulation.seeds.spacing), &POSITIVE, .doc = "between the centres of neighbouring seeds of a strand, unless the command gives another"},

    {"guides[].name", "", NAME, GUIDE(name), .list = GUIDES, .required = true, .doc = "of a plate with holes, such as a template, outside the tissue"},
    {"guides[].origin", "m", POINT, GUIDE(origin), .list = GUIDES, .required = true, .doc = "middle of the holes on the front face, where needles enter"},
    {"guides[].normal", "", POINT, GUIDE(normal), .list = GUIDES, .required = true, .doc = "direction in which needles pass through; any length"},
    {"guides[].along", "", POINT, GUIDE(along), .list = GUIDES, .doc = "direction along which columns are counted; required for more than one hole"},
    {"guides[].rows_along", "", POINT, GUIDE(rows_along), .list = GUIDES,
     .doc = "direction along which rows are counted, perpendicular to along; default: the normal x along. Set it if letters run the other way"},
    {"guides[].columns", "", COUNT, GUIDE(columns), &HOLES, .list = GUIDES, .doc = "of holes"},
    {"guides[].rows", "", COUNT, GUIDE(rows), &HOLES, .list = GUIDES, .doc = "of holes"},
    {"guides[].spacing", "m", NUMBER, GUIDE(spacing), &POSITIVE, .list = GUIDES, .doc = "between the axes of neighbouring holes"},
    {"guides[].hole_diameter", "m", NUMBER, GUIDE(hole_diameter), &POSITIVE, .list = GUIDES, .required = true,
     .doc = "at least the needle's outer diameter"},
    {"guides[].thickness", "m", NUMBER, GUIDE(thickness), &NOT_NEGATIVE, .list = GUIDES,
     .doc = "of the plate; 0: one plane, which does not guide the needle's direction"},
    {"guides[].stiffness", "N/m", NUMBER, GUIDE(stiffness), &POSITIVE, .live = true, .list = GUIDES, .doc = "of a hole's edge"},
    {"guides[].friction", "", NUMBER, GUIDE(friction), &NOT_NEGATIVE, .live = true, .list = GUIDES, .doc = "coefficient of friction in the holes"},

    {"probe.surface", "", NAME, OF(simulation.probe.surface), .required = true, .doc = "a physical surface of the mesh that the probe presses, such as the rectum's wall; without it there is no probe"},
    {"probe.radius", "m", NUMBER, OF(simulation.probe.shape.radius), &POSITIVE, .doc = "of the ultrasound probe, a rigid cylinder"},
    {"probe.tip_radius", "m", NUMBER, OF(simulation.probe.shape.tip_radius), &NOT_NEGATIVE,
     .doc = "of the rounded edge at its end; at most the radius, which makes the end a hemisphere"},
    {"probe.length", "m", NUMBER, OF(simulation.probe.shape.length), &POSITIVE, .doc = "from its base, where the hand holds it, to its tip"},
    {"probe.max_force", "N", NUMBER, OF(simulation.probe.max_force), &POSITIVE,
     .doc = "the probe stops where the tissue's force on it would exceed this, and moves again when the hand draws back"},
    {"probe.start.position", "m", POINT, OF(simulation.probe.start.position), .required = true, .doc = "of its base until a pose is given; without it there is no probe until then"},
    {"probe.start.orientation", "", ROTATION, OF(simulation.probe.start.orientation), .doc = "unit quaternion w, x, y, z that turns +z into its axis, from base to tip"},

    {"contact.spacing", "m", NUMBER, OF(simulation.insertion.contact_spacing), &POSITIVE, .doc = "least distance between contact nodes"},
    {"contact.weakening_distance", "m", NUMBER, OF(simulation.insertion.weakening_distance), &POSITIVE,
     .doc = "of sliding over which static friction falls to kinetic"},
    {"contact.prefetch_distance", "m", NUMBER, OF(simulation.insertion.prefetch_distance), &NOT_NEGATIVE,
     .doc = "of the path ahead of the tip for which the worker prepares elements"},
    {"contact.max_passes", "", COUNT, OF(simulation.insertion.max_passes), &PASSES, .doc = "Newton passes in a step, at most"},
    {"contact.tolerance", "m", NUMBER, OF(simulation.insertion.tolerance), &POSITIVE, .doc = "error of the needle's shape at which passes stop"},
    {"contact.bone_compliance", "m/N", NUMBER, OF(simulation.insertion.bone_compliance), &POSITIVE,
     .doc = "of bone under the tip: a fixed surface, or one with nothing behind it, with puncture_force .inf"},
    {"contact.surface_friction", "", NUMBER, OF(simulation.insertion.surface_friction), &NOT_NEGATIVE,
     .doc = "friction coefficient of the tip on a surface that it has not punctured"},
    {"contact.gradient_span", "m", NUMBER, OF(simulation.insertion.gradient_span), &POSITIVE,
     .doc = "before and behind the tip, between which the tissue's displacement gradient is taken, along which the tip is led"},

    {"tracks.reach", "", NUMBER, OF(simulation.insertion.track_reach), &NOT_NEGATIVE,
     .doc = "distance, in needle diameters, within which an old track and its punctures are open to the tip; 0: tissue closes behind the needle"},
    {"tracks.angle", "rad", NUMBER, OF(simulation.insertion.track_angle), &ANGLE,
     .doc = "largest angle between an old track and the direction of the cut at which the tip follows the track"},

    {"inverse", "", WORD, OF(simulation.inverse), .words = inverse_word,
     .doc = "auto: dense below 1 GB, else condensed with a region_of_interest, else sparse"},
    {"volumetric_strain", "", WORD, OF(simulation.volumetric), .words = strain_word, .doc = "averaged over patches of tetrahedra or at nodes, which prevents locking, or by element"},
    {"inverse_precision", "", WORD, OF(simulation.precision), .words = precision_word, .doc = "of a condensed inverse; auto: double up to 0.5 GB"},
    {"cache", "", DIRECTORY_PATH, OF(simulation.cache), .doc = "directory of condensed inverses; by default $XDG_CACHE_HOME/trocar"},

    {"region_of_interest.regions", "", NAMES, OF(simulation.roi.regions), .doc = "regions that needles reach"},
    {"region_of_interest.corridor.from", "m", POINT, OF(simulation.roi.from), .required = true, .doc = "start of the corridor's axis"},
    {"region_of_interest.corridor.to", "m", POINT, OF(simulation.roi.to), .required = true, .doc = "end of the corridor's axis"},
    {"region_of_interest.corridor.radius", "m", NUMBER, OF(simulation.roi.radius), &POSITIVE, .required = true, .doc = "of the corridor"},

    {"device.profile", "", PROFILE, OF(profile), .words = profile_word, .doc = "a device by name, or a file with keys of this section; explicit keys override it"},
    {"device.max_stiffness", "N/m", NUMBER, OF(device.max_stiffness), &STIFFNESS, .doc = "of the virtual coupling; .inf: none"},
    {"device.mass", "kg", NUMBER, OF(device.mass), &POSITIVE, .doc = "of device and hand at the handle; the coupling is designed for half of it"},
    {"device.delay", "s", NUMBER, OF(device.delay), &DEVICE_DELAY, .doc = "round trip between bridge and device, which poses do not show; the coupling is designed for it"},
    {"device.max_force", "N", NUMBER, OF(device.max_force), &POSITIVE, .doc = "largest force sent to the hand"},
    {"device.max_torque", "N m", NUMBER, OF(device.max_torque), &POSITIVE, .doc = "largest torque sent to the hand"},
    {"device.max_force_rate", "N/s", NUMBER, OF(device.max_force_rate), &POSITIVE, .doc = "largest rate of change of the force"},
    {"device.max_torque_rate", "N m/s", NUMBER, OF(device.max_torque_rate), &POSITIVE, .doc = "largest rate of change of the torque"},
    {"device.max_speed", "m/s", NUMBER, OF(device.max_speed), &POSITIVE, .doc = "of the hand; poses that move faster are refused"},
    {"device.max_turn_rate", "rad/s", NUMBER, OF(device.max_turn_rate), &POSITIVE, .doc = "poses that turn faster are refused"},
    {"device.hold_time", "s", NUMBER, OF(device.hold_time), &NOT_NEGATIVE, .doc = "without a pose before the wrench is ramped down"},
    {"device.ramp_time", "s", NUMBER, OF(device.ramp_time), &POSITIVE, .doc = "of every ramp"},
    {"device.workspace", "m", POINT, OF(mapping.workspace), .doc = "width, height and depth in which the hand moves the device; trocar-device --profile compares the needle's travel with the depth"},
    {"device.scale", "", NUMBER, OF(mapping.scale), &SCALE, .doc = "motion of the needle per motion of the hand, which the bridge applies; other keys of this section hold at the handle"},
    {"device.force_scale", "", NUMBER, OF(mapping.force_scale), &SCALE, .doc = "force on the hand per force on the needle, which the bridge applies"},
    {"device.clutch", "", WORD, OF(mapping.clutch), .words = switch_word, .doc = "true: the bridge has a clutch, with which the hand moves while the needle stays where it is"},
};
enum { ROWS = sizeof SCENE_TABLE / sizeof *SCENE_TABLE };
_Static_assert((int)ROWS <= (int)SCENE_KEYS_MOST, "trocar_key_at has no room for more keys: raise SCENE_KEYS_MOST");
const int SCENE_ROWS = ROWS;

const list_spec LIST_TABLE[LISTS] = {
    [REGIONS] = {"regions", OF(simulation.regions), OF(simulation.region_count), sizeof(region_config), 1, MAX_REGIONS, .named = true},
    [MEMBRANES] = {"membranes", OF(simulation.membranes), OF(simulation.membrane_count), sizeof(membrane_config), 0, MAX_MEMBRANES, .named = true},
    [SLIDING] = {"sliding", OF(simulation.sliding), OF(simulation.sliding_count), sizeof(sliding_config), 0, MAX_SLIDING, .named = true},
    [CALCIFICATIONS] = {"calcifications", OF(simulation.calcifications), OF(simulation.calcification_count), sizeof(calcification), 0, MAX_CALCIFICATIONS, .named = false},
    [GUIDES] = {"guides", OF(simulation.guides), OF(simulation.guide_count), sizeof(guide_config), 0, MAX_GUIDES, .named = true},
    [RELAXATION] = {"relaxation", OF(simulation.relaxation), OF(simulation.relaxation_count), sizeof(relaxation_term), 0, MAX_RELAXATION, .named = false},
};

void *entry_of(scene *s, list_kind list, int index) {
    return (char *)s + LIST_TABLE[list].entries + (size_t)index * LIST_TABLE[list].stride;
}
int *count_of(scene *s, list_kind list) { return (int *)((char *)s + LIST_TABLE[list].count); }
/* An entry's name is its first member. */
const char *name_of(const scene *s, list_kind list, int index) { return LIST_TABLE[list].named ? entry_of((scene *)s, list, index) : NULL; }
_Static_assert(offsetof(region_config, name) == 0 && offsetof(membrane_config, name) == 0 && offsetof(sliding_config, name) == 0 && offsetof(guide_config, name) == 0, "name_of relies on it");

int *names_count(scene *s, const key_spec *r, int *least, int *most) {
    bool fixed = r->offset == OF(simulation.fixed);
    *least = fixed ? 1 : 0;
    *most = fixed ? MAX_FIXED : REACH_MAX_REGIONS;
    return fixed ? &s->simulation.fixed_count : &s->simulation.roi.region_count;
}

void *append_entry(scene *s, list_kind list) {
    void *entry = entry_of(s, list, (*count_of(s, list))++);
    memset(entry, 0, LIST_TABLE[list].stride);
    if (list == REGIONS) ((region_config *)entry)->material = region_defaults();
    if (list == MEMBRANES) ((membrane_config *)entry)->material = membrane_defaults();
    if (list == SLIDING) ((sliding_config *)entry)->material = sliding_defaults();
    if (list == CALCIFICATIONS) *(calcification *)entry = calcification_defaults();
    if (list == GUIDES) *(guide_config *)entry = guide_defaults();
    return entry;
}

const key_spec *find_key(const char *pattern) {
    for (int i = 0; i < ROWS; i++)
        if (strcmp(SCENE_TABLE[i].key, pattern) == 0) return &SCENE_TABLE[i];
    return NULL;
}

bool leads_on(const char *pattern, const char *next) {
    size_t length = strlen(pattern);
    for (int i = 0; i < ROWS; i++)
        if (strncmp(SCENE_TABLE[i].key, pattern, length) == 0 && strncmp(SCENE_TABLE[i].key + length, next, strlen(next)) == 0) return true;
    return false;
}

static const struct { const char *name; double size; } UNITS[] = {{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}};
enum { UNIT_COUNT = sizeof UNITS / sizeof *UNITS };
const char UNIT_WORDS[] = "m, cm, mm, or the unit's size in m (1e-9 to 1000)";

double unit_size(const char *name) {
    for (int i = 0; i < UNIT_COUNT; i++)
        if (strcmp(name, UNITS[i].name) == 0) return UNITS[i].size;
    return 0.0;
}

int scene_key_count(void) { return ROWS; }

void list_words(word_of word, char *list, size_t size) {
    size_t used = 0;
    for (int i = 0; word(i) && used < size; i++)
        used += (size_t)snprintf(list + used, size - used, "%s%s", i == 0 ? "" : word(i + 1) ? ", " : " or ", word(i));
}

void describe_words(const key_spec *r, char *text, size_t size) {
    list_words(r->words, text, size);
    size_t used = strlen(text);
    if (r->kind == PROFILE) snprintf(text + used, size - used, ", or the path of a %s file", PROFILE_SUFFIX);
}

scene_key_info scene_key_at(int index) {
    static char lists[ROWS][WORDS_ROOM];
    static const char *const others[] = {[NAME] = "a name", [NAMES] = "a list of names", [FILE_PATH] = "a path", [DIRECTORY_PATH] = "a path",
                                         [POINT] = "three numbers", [ROTATION] = "four numbers", [TRANSFORM] = "sixteen numbers"};
    const key_spec *r = &SCENE_TABLE[index];
    const char *accepts = r->allowed ? r->allowed->words : r->kind == LENGTH_UNIT ? UNIT_WORDS : others[r->kind];
    if (r->words) {
        describe_words(r, lists[index], sizeof lists[index]);
        accepts = lists[index];
    }
    static const trocar_key_kind kinds[] = {
        [NUMBER] = TROCAR_KEY_NUMBER, [COUNT] = TROCAR_KEY_NUMBER, [LENGTH_UNIT] = TROCAR_KEY_NUMBER, [WORD] = TROCAR_KEY_TEXT, [PROFILE] = TROCAR_KEY_TEXT,
        [NAME] = TROCAR_KEY_TEXT, [FILE_PATH] = TROCAR_KEY_TEXT, [DIRECTORY_PATH] = TROCAR_KEY_TEXT, [NAMES] = TROCAR_KEY_NAMES,
        [POINT] = TROCAR_KEY_NUMBERS, [ROTATION] = TROCAR_KEY_NUMBERS, [TRANSFORM] = TROCAR_KEY_NUMBERS};
    return (scene_key_info){r->key, r->unit, accepts, r->doc, r->required, kinds[r->kind]};
}
