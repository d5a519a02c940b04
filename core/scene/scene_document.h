/* Reads a scene document, which consists of sections, lists and keys, according to the table. */
#ifndef TROCAR_SCENE_DOCUMENT_H
#define TROCAR_SCENE_DOCUMENT_H

#include "scene/scene_value.h"

/* Reads all keys of a document into the scene. `f` records the first fault. */
void take_document(scene *s, const yaml_value *root, fault *f);

#endif
