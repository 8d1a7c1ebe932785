// Camera rays.
#ifndef GLEANER_KERNELS_CAMERA_H
#define GLEANER_KERNELS_CAMERA_H

#include "kernels/vec3.h"
#include "scene/model/records.h"

// The ray through the point (jx, jy) of [0, 1)^2 within the pixel's square; row 0 is the top.
FN void camera_ray(global const Camera* camera, uint width, uint height, vu pixel, vf jx, vf jy, v3* origin,
                   v3* direction) {
  vu row = pixel / width;
  vu column = pixel - row * width;
  vf sx = 2.0f * (to_f(column) + jx) / (float)width - 1.0f;
  vf sy = 1.0f - 2.0f * (to_f(row) + jy) / (float)height;
  v3 right = uniform3(camera->right[0], camera->right[1], camera->right[2]);
  v3 up = uniform3(camera->up[0], camera->up[1], camera->up[2]);
  *origin = uniform3(camera->origin[0], camera->origin[1], camera->origin[2]);
  *direction = uniform3(camera->forward[0], camera->forward[1], camera->forward[2]);
  vf ax = sx * camera->half_width, ay = sy * camera->half_height;
  v3 aside = mad3(right, ax, scale3(up, ay));
  if (camera->type == GLEANER_CAMERA_ORTHOGRAPHIC) {
    *origin = add3(*origin, aside);
  } else {
    *direction = normalize3(add3(*direction, aside));
  }
}

#endif
