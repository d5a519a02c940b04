/* trocar: a flexible needle in soft tissue, for haptic servers, planners and batches.

   A scene describes what to simulate. A model is built from it once and never changes, so any number of simulations in any number of threads can
   share it. A simulation holds everything that does change, and takes a few MB.

       trocar_scene *scene;  trocar_model *model;  trocar_sim *sim;  trocar_error why;  trocar_output out;
       trocar_scene_load("scene.yaml", &scene, &why);
       trocar_model_create(scene, NULL, &model, &why);
       trocar_sim_create(model, &sim, &why);
       trocar_sim_reset(sim, 0, &base, &why);
       trocar_sim_step(sim, 0, &base, 0.001, &out, &why);        out.force is what the hand feels

   Units are SI: m, N, N m, Pa, s, rad. The world frame is the mesh's frame. Quaternions are unit quaternions, stored w, x, y, z. The needle's axis is
   its local +z, from base to tip; its bevel faces local +y. Numbers in text always use a decimal point, whatever the locale.

   Functions that can fail return a status and write a message to `error`, which may be NULL. The message says where the error is and how to fix it. No
   function prints, exits or changes signal handlers. *_free accepts NULL.

   The mark on each function says which threads may call it, and whether a real-time thread may.

       [any]        any thread, at any time
       [one]        one thread at a time for each object
       [tick]       the thread that ticks the simulation; the worker thread may work at the same time
       [work]       the simulation's worker thread; the ticking thread may tick at the same time
       [alone]      while no other thread uses the simulation
       RT           does not allocate, lock, wait or make system calls
       RT, wakes    like RT, except for one write() to an eventfd if there is work for the worker
       allocates    allocates memory */
#ifndef TROCAR_H
#define TROCAR_H

#include "trocar/errors.h"
#include "trocar/pose.h"
#include "trocar/scene.h"
#include "trocar/model.h"
#include "trocar/sim.h"
#include "trocar/change.h"
#include "trocar/needle.h"
#include "trocar/rest.h"
#include "trocar/probe.h"
#include "trocar/seeds.h"
#include "trocar/view.h"
#include "trocar/picture.h"
#include "trocar/rollout.h"
#include "trocar/batch.h"
#include "trocar/derivatives.h"
#include "trocar/operator.h"
#include "trocar/dose.h"

#endif
