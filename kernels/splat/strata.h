// Where rays pass through the strata of a record's hemisphere: a grid of `polar` rings of `azimuthal` strata each.
#ifndef GLEANER_KERNELS_SPLAT_STRATA_H
#define GLEANER_KERNELS_SPLAT_STRATA_H

#include "kernels/sampling.h"

// In [0, 1), of so few bits that the number of a stratum and it have an exact sum.
FN vf part_of_stratum(vu x) { return to_f(x >> 18) * (vf)6.103515625e-5f; }

// Of a grid of powers of two, in parts of a stratum. Each coordinate is the scrambled radical inverse of the other
// one's index, so that the rays are one (0, m, 2)-net: strata of every other shape have one each, too (Chiu, Shirley &
// Wang 1994, "Multi-Jittered Sampling"). `key`: of the record.
FN void net_in_strata(vu key, vu ring, vu sector, vf* u0, vf* u1) {
  *u0 = part_of_stratum(reverse_bits(permute_upward(ring, hash_combine(key, (vu)0x52494e47u))));
  *u1 = part_of_stratum(reverse_bits(permute_upward(sector, hash_combine(key, (vu)0x53454354u))));
}

// The ray of a stratum, ring by ring: u0 around, u1 from the normal on, both in [0, 1). `key`: of the record.
FN void stratum_sample(vu key, vu stratum, uint polar, uint azimuthal, vf* u0, vf* u1) {
  vu ring = stratum / azimuthal, sector = stratum - ring * azimuthal;
  if (((polar & (polar - 1u)) | (azimuthal & (azimuthal - 1u))) == 0u) {
    net_in_strata(key, ring, sector, u0, u1);
  } else {
    // Radical inverses of other numbers have gaps. Multiples of the golden ratio spread any number evenly; the random
    // shift makes every place of a stratum as likely (Cranley & Patterson 1976).
    *u0 = part_of_stratum(ring * 0x9e3779b9u + hash_combine(key, (vu)0x52494e47u));
    *u1 = part_of_stratum(sector * 0x9e3779b9u + hash_combine(key, (vu)0x53454354u));
  }
  *u0 = (to_f(sector) + *u0) / (float)azimuthal;
  *u1 = (to_f(ring) + *u1) / (float)polar;
}

#endif
