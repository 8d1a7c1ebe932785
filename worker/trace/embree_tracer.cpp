#include <xmmintrin.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "kernels/rays.h"
#include "worker/trace/embree_levels.h"

namespace gleaner::worker {
namespace {

static_assert(offsetof(RTCRayHit16, ray.org_x) == 64 * ROW_ORIGIN &&
              offsetof(RTCRayHit16, ray.tnear) == 64 * ROW_NEAR &&
              offsetof(RTCRayHit16, ray.dir_x) == 64 * ROW_DIRECTION &&
              offsetof(RTCRayHit16, ray.time) == 64 * ROW_TIME && offsetof(RTCRayHit16, ray.tfar) == 64 * ROW_FAR &&
              offsetof(RTCRayHit16, ray.mask) == 64 * ROW_MASK && offsetof(RTCRayHit16, ray.id) == 64 * ROW_SOURCE &&
              offsetof(RTCRayHit16, ray.flags) == 64 * ROW_FLAGS && sizeof(RTCRay16) == 64 * RAY_ROWS &&
              offsetof(RTCRayHit16, hit.Ng_x) == 64 * ROW_NORMAL && offsetof(RTCRayHit16, hit.u) == 64 * ROW_U &&
              offsetof(RTCRayHit16, hit.v) == 64 * ROW_V && offsetof(RTCRayHit16, hit.primID) == 64 * ROW_PRIMITIVE &&
              offsetof(RTCRayHit16, hit.geomID) == 64 * ROW_GEOMETRY &&
              offsetof(RTCRayHit16, hit.instID) == 64 * ROW_INSTANCE && sizeof(RTCRayHit16) >= 64 * RAY_HIT_ROWS);

// Makes rays that `valid` leaves out end before they begin, as long as it lives. Embree without instructions for 16
// lanes hands packets of 16 to its ray streams, which do not look at `valid`; for them such a ray asks nothing.
class Silence {
 public:
  Silence(const int* valid, RTCRay16* rays) : valid_(valid), rays_(rays) {
    for (int k = 0; k < 16; ++k) {
      near_[k] = rays->tnear[k];
      far_[k] = rays->tfar[k];
      if (valid[k]) continue;
      rays->tnear[k] = std::numeric_limits<float>::infinity();
      rays->tfar[k] = -std::numeric_limits<float>::infinity();
    }
  }
  ~Silence() {
    for (int k = 0; k < 16; ++k) {
      if (valid_[k]) continue;
      rays_->tnear[k] = near_[k];
      rays_->tfar[k] = far_[k];
    }
  }
  Silence(const Silence&) = delete;
  Silence& operator=(const Silence&) = delete;

 private:
  const int* valid_;
  RTCRay16* rays_;
  float near_[16], far_[16];
};

class Query {
 public:
  // `native`: the device has instructions for 16 lanes.
  Query(bool coherent, bool native) : coherent_(coherent), native_(native) {
#ifdef GLEANER_EMBREE4
    rtcInitIntersectArguments(&closest_);
    rtcInitOccludedArguments(&any_);
    closest_.flags = any_.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
#else
    rtcInitIntersectContext(&context_);
    context_.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
#endif
  }
  bool coherent() const { return coherent_; }
  void closest(RTCScene scene, const int* valid, RTCRayHit16* rays) {
    std::optional<Silence> silence;
    if (!native_) silence.emplace(valid, &rays->ray);
#ifdef GLEANER_EMBREE4
    rtcIntersect16(valid, scene, rays, &closest_);
#else
    rtcIntersect16(valid, scene, &context_, rays);
#endif
  }
  void any(RTCScene scene, const int* valid, RTCRay16* rays) {
    std::optional<Silence> silence;
    if (!native_) silence.emplace(valid, rays);
#ifdef GLEANER_EMBREE4
    rtcOccluded16(valid, scene, rays, &any_);
#else
    rtcOccluded16(valid, scene, &context_, rays);
#endif
  }

 private:
  bool coherent_, native_;
#ifdef GLEANER_EMBREE4
  RTCIntersectArguments closest_;
  RTCOccludedArguments any_;
#else
  RTCIntersectContext context_;
#endif
};

struct alignas(64) Valid {
  int lanes[16];
};

// Lanes of the first `count` that ask something: what the others hold may be anything, and Embree must not look at it.
// Neither at numbers beyond what it takes for infinite, nor at NaN: Debian's aborts the program.
Valid asking(const float* block, std::uint32_t count) {
  constexpr float most = 1.844e18f;
  Valid valid;
  for (std::uint32_t k = 0; k < 16; ++k) valid.lanes[k] = k < count && block[RAY_BLOCK * ROW_FAR + k] > 0 ? -1 : 0;
  for (unsigned row : {ROW_ORIGIN, ROW_ORIGIN + 1, ROW_ORIGIN + 2, ROW_DIRECTION, ROW_DIRECTION + 1, ROW_DIRECTION + 2})
    for (std::uint32_t k = 0; k < 16; ++k)
      valid.lanes[k] = std::fabs(block[RAY_BLOCK * row + k]) <= most ? valid.lanes[k] : 0;
  return valid;
}

// Of `valid`, the lanes whose rays may meet the box: most rays pass by what a top level holds, and asking Embree for
// each of them takes longer than all sixteen take here. Rounding is on the safe side, and so are directions along an
// axis.
Valid may_meet(const RTCBounds& box, const Valid& valid, const RTCRay16* rays) {
  constexpr float slack = 1e-4f, least = 1e-20f;
  const float low[3] = {box.lower_x, box.lower_y, box.lower_z}, high[3] = {box.upper_x, box.upper_y, box.upper_z};
  const float* origins[3] = {rays->org_x, rays->org_y, rays->org_z};
  const float* directions[3] = {rays->dir_x, rays->dir_y, rays->dir_z};
  float enters[16], leaves[16];
  for (int k = 0; k < 16; ++k) {
    enters[k] = rays->tnear[k];
    leaves[k] = rays->tfar[k];
  }
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0; k < 16; ++k) {
      const float o = origins[axis][k], d = directions[axis][k];
      const float room = slack * (std::fabs(o) + std::fabs(low[axis]) + std::fabs(high[axis]));
      const bool along = std::fabs(d) < least;  // nothing is said of this axis
      const float inverse = 1 / (along ? 1.0f : d);
      const float a = (low[axis] - room - o) * inverse, b = (high[axis] + room - o) * inverse;
      const float first = a < b ? a : b, last = a < b ? b : a;
      enters[k] = !along && first > enters[k] ? first : enters[k];
      leaves[k] = !along && last < leaves[k] ? last : leaves[k];
    }
  Valid met;
  for (int k = 0; k < 16; ++k)
    met.lanes[k] =
        enters[k] - slack * std::fabs(enters[k]) > leaves[k] + slack * std::fabs(leaves[k]) ? 0 : valid.lanes[k];
  return met;
}

// Incoherent rays too begin as a packet while most lanes go the same way, as they do among a few instances. The order
// in which these are met then depends on a ray's neighbours, and where two of them touch, so does which one is hit. One
// lane at a time is traced by itself.
template <typename Call>
void one_by_one(const Valid& valid, Call&& call) {
  for (std::uint32_t k = 0; k < 16; ++k) {
    if (!valid.lanes[k]) continue;
    Valid one{};
    one.lanes[k] = valid.lanes[k];
    call(one);
  }
}

class EmbreeTracer final : public Tracer {
 public:
  EmbreeTracer(const scene::Scene& scene, unsigned threads, const std::string& isa) : levels_(scene, threads, isa) {}

  void closest(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    walk(queue, rays, range, [this](Query& query, const Valid& valid, float* block) {
      auto* hits = reinterpret_cast<RTCRayHit16*>(block);
      find_closest(query, valid, hits);
      retrace_self_hits(valid, hits);
    });
  }

  void any(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    walk(queue, rays, range, [this](Query& query, const Valid& asking, float* block) {
      auto* asked = reinterpret_cast<RTCRay16*>(block);
      if (levels_.world()) query.any(levels_.world(), asking.lanes, asked);
      if (!levels_.top()) return;
      Valid valid;
      for (int k = 0; k < 16; ++k) valid.lanes[k] = asked->tfar[k] > 0 ? asking.lanes[k] : 0;
      // Each ray for itself: asked as a packet, Embree 3.13.5 may loop for ever once a ray of another octant than the
      // one it is at has ended in an instance.
      Query single = new_query(false);
      one_by_one(may_meet(levels_.top_bounds(), valid, asked),
                 [&](const Valid& one) { single.any(levels_.top(), one.lanes, asked); });
    });
  }

  MotionReport follow(const SceneMotion& motion) override { return levels_.follow(motion); }

 private:
  // On CPU devices mapping moves nothing: Embree reads and writes where the kernels do.
  class Mapped {
   public:
    Mapped(cl::CommandQueue& queue, cl::Buffer& buffer, const RayRange& range)
        : queue_(queue),
          buffer_(buffer),
          pointer_(queue.enqueueMapBuffer(buffer, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0,
                                          std::size_t{64} * range.rows * ((range.end() + 15) / 16))) {}
    ~Mapped() {
      try {
        queue_.enqueueUnmapMemObject(buffer_, pointer_);
      } catch (const cl::Error&) {
        // The next command on the queue meets the same failure and reports it.
      }
    }
    Mapped(const Mapped&) = delete;
    Mapped& operator=(const Mapped&) = delete;
    float* floats() { return static_cast<float*>(pointer_); }

   private:
    cl::CommandQueue& queue_;
    cl::Buffer& buffer_;
    void* pointer_;
  };

  template <typename Visit>
  void walk(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range, Visit&& visit) {
    Mapped mapped(queue, rays, range);
    const std::size_t stride = std::size_t{RAY_BLOCK} * range.rows;
    const unsigned control = _mm_getcsr();
    // Embree asks for flushed denormals; it loses much time on them.
    _mm_setcsr(control | 0x8040);
    const auto run = [&](Query query, std::uint32_t base, std::uint32_t count) {
      for (std::uint32_t i = 0; i < count; i += RAY_BLOCK) {
        float* block = mapped.floats() + stride * ((base + i) / RAY_BLOCK);
        visit(query, asking(block, count - i), block);
      }
    };
    run(new_query(false), 0, range.incoherent);
    run(new_query(true), range.coherent_base, range.coherent_count);
    _mm_setcsr(control);
  }

  Query new_query(bool coherent) const { return {coherent, levels_.native_packets()}; }

  // Hits with the scene's numbers for triangle and instance.
  void find_closest(Query& query, const Valid& valid, RTCRayHit16* rays) {
    if (levels_.world()) {
      query.closest(levels_.world(), valid.lanes, rays);
      name_world_hits(valid, rays);
    }
    if (levels_.top()) {
      const auto ask = [&](const Valid& asking) { query.closest(levels_.top(), asking.lanes, rays); };
      if (query.coherent())
        ask(valid);  // always the same neighbours
      else
        one_by_one(may_meet(levels_.top_bounds(), valid, &rays->ray), ask);
      name_top_hits(valid, rays);
    }
  }

  void name_world_hits(const Valid& valid, RTCRayHit16* rays) const {
    if (!levels_.top()) return;  // a geometry of all triangles, and nobody asks for an instance
    const std::vector<std::uint32_t>& firsts = levels_.world_firsts();
    for (int k = 0; k < 16; ++k) {
      if (!valid.lanes[k] || rays->hit.geomID[k] == RTC_INVALID_GEOMETRY_ID) continue;
      rays->hit.primID[k] += firsts[rays->hit.geomID[k]];
      rays->hit.geomID[k] = 0;
      rays->hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
    }
  }

  // Embree names an instance where it hit one in the top level; what was hit in the world before has none.
  void name_top_hits(const Valid& valid, RTCRayHit16* rays) const {
    for (int k = 0; k < 16; ++k) {
      if (!valid.lanes[k] || rays->hit.geomID[k] == RTC_INVALID_GEOMETRY_ID ||
          rays->hit.instID[0][k] == RTC_INVALID_GEOMETRY_ID)
        continue;
      const EmbreeLevels::Row& row = levels_.rows()[rays->hit.instID[0][k]];
      rays->hit.primID[k] += row.first_triangle;
      rays->hit.instID[0][k] = row.instance;
    }
  }

  // Whether a lane's hit is on the triangle that its ray left: of the same instance, where there are any.
  bool is_self_hit(const RTCRayHit16* rays, int k) const {
    return rays->hit.geomID[k] != RTC_INVALID_GEOMETRY_ID && rays->hit.primID[k] == rays->ray.id[k] &&
           (!levels_.has_instances() || rays->hit.instID[0][k] == rays->ray.flags[k]);
  }

  // A plane is never left through itself: where rounding says so all the same, the search goes on behind that hit.
  void retrace_self_hits(const Valid& valid, RTCRayHit16* rays) {
    // All lanes at once, so that the compiler makes vector code of it; a hit on the source is next to never.
    std::uint32_t self = 0;
    for (std::uint32_t k = 0; k < 16; ++k)
      self |= static_cast<std::uint32_t>(valid.lanes[k] && rays->hit.geomID[k] != RTC_INVALID_GEOMETRY_ID &&
                                         rays->hit.primID[k] == rays->ray.id[k])
              << k;
    while (self) {
      const int lane = __builtin_ctz(self);
      self &= self - 1;
      Query query = new_query(false);
      for (int tries = 0; tries < 4 && is_self_hit(rays, lane); ++tries) {
        rays->ray.tnear[lane] = std::nextafter(rays->ray.tfar[lane], std::numeric_limits<float>::infinity());
        rays->ray.tfar[lane] = std::numeric_limits<float>::infinity();
        rays->hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
        Valid one{};
        one.lanes[lane] = -1;
        find_closest(query, one, rays);
      }
    }
  }

  EmbreeLevels levels_;
};

}  // namespace

bool embree_available() { return true; }

std::unique_ptr<Tracer> make_embree_tracer(const scene::Scene& scene, unsigned threads, const std::string& isa) {
  return std::make_unique<EmbreeTracer>(scene, threads, isa);
}

}  // namespace gleaner::worker
