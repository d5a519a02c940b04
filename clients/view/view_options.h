/* The command line of trocar-view. */
#ifndef TROCAR_VIEW_OPTIONS_H
#define TROCAR_VIEW_OPTIONS_H

#include "view/implant/implant.h"
#include "view/web/web.h"

/* Content and size of a saved picture. */
typedef struct {
    int width, height;       /* pixels */
    int view;                /* 1 to 4: the key that selects this view on the page */
    const char *theme;
    char cut;                /* axis normal to the cut; 0 if there is no cut */
    double place;            /* m, position of the cut on its axis; NAN: at the tip */
} picture;

typedef struct {
    const char *scene_path, *lcm_url, *log_path, *png_path;
    const char *task, *runs; /* path of a trainee's task, and folder for the recorded runs; NULL if not given */
    double at;               /* s; INFINITY: the end of the log */
    picture picture;
    const char *picture_option;   /* name of the last option given that needs --png; NULL if there is none */
    const char *live_option; /* name of the last option given that needs a live server; NULL if there is none */
    implant_settings implant;
    web_settings web;
} view_options;

/* Parses the options, with their defaults. Exits with EXIT_BAD_INPUT and a message for mistakes, and with 0 after --help and --version. */
view_options read_view_options(int count, char **arguments);

#endif
