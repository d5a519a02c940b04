/* The model's results as messages. */
#ifndef TROCAR_MESSAGES_H
#define TROCAR_MESSAGES_H

#include "insertion/insertion.h"
#include "trocar_needle_wrench_t.h"

/* One tick's wrench as the model computed it, raw and to be rendered alike, with the flags that follow from its events. Which
   tick, which pose and when is its caller's. RT */
trocar_needle_wrench_t wrench_message(const insertion_wrench *wrench);

void store_vec3(vec3 v, double out[3]); /* RT */

#endif
