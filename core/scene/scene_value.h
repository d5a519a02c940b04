/* Values of scene keys: reads them from YAML into the scene, and prints them as text. */
#ifndef TROCAR_SCENE_VALUE_H
#define TROCAR_SCENE_VALUE_H

#include "scene/scene_table.h"
#include "yaml/yaml_text.h"

/* The first fault that was found; later ones are ignored. */
typedef struct {
    bool found;
    char place[KEY_ROOM];    /* key whose line is reported */
    char key[KEY_ROOM];      /* key that the message names; may be empty */
    char words[WORDS_ROOM];
} fault;

__attribute__((format(printf, 4, 5)))
void reject_at(fault *f, const char *place, const char *key, const char *format, ...);
#define reject(f, key, ...) reject_at(f, key, key, __VA_ARGS__)

/* Stores the value of one key in the scene; `base` is the scene or the list's entry. */
void take_value(scene *s, const key_spec *r, const char *key, void *base, const yaml_value *value, fault *f);

/* Prints a value as YAML. Returns the length of the text, like snprintf. */
int print_value(const scene *s, const key_spec *r, const void *base, char *value, size_t size);

#endif
