/* The command line of trocar-view. */
#ifndef TROCAR_VIEW_OPTIONS_H
#define TROCAR_VIEW_OPTIONS_H

#include "view/implant/implant.h"
#include "view/web/web.h"

/* What a saved picture shows, and its size. */
typedef struct {
    int width, height;       /* pixels */
    int view;                /* 1 to 4, the key for this view on the page */
    const char *theme;
    char cut;                /* axis normal to the cut; 0 for no cut */
    double place;            /* m, position of the cut on its axis; NAN for the tip */
} picture;

typedef struct {
    const char *scene_path, *lcm_url, *log_path, *png_path;
    const char *task, *runs; /* path of a trainee's task, and folder for the recorded runs; NULL if not given */
    double at;               /* s; INFINITY for the end of the log */
    picture picture;
    const char *picture_option;   /* the last option given that needs --png; NULL for none */
    const char *live_option; /* the last option given that needs a live server; NULL for none */
    implant_settings implant;
    web_settings web;
} view_options;

/* Parses the options and fills in defaults. Exits with a message and EXIT_BAD_INPUT on mistakes, and with 0 after --help and --version. */
view_options read_view_options(int count, char **arguments);

#endif
