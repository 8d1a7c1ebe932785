#include <xmmintrin.h>

#include <cmath>
#include <cstring>
#include <limits>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#define GLEANER_EMBREE4
#else
#include <embree3/rtcore.h>
#endif

#include "kernels/rays.h"
#include "scene/model/error.h"
#include "worker/trace/tracer.h"

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
              offsetof(RTCRayHit16, hit.geomID) == 64 * ROW_GEOMETRY && sizeof(RTCRayHit16) >= 64 * RAY_HIT_ROWS);

class Query {
 public:
  Query(RTCScene scene, bool coherent) : scene_(scene) {
#ifdef GLEANER_EMBREE4
    rtcInitIntersectArguments(&closest_);
    rtcInitOccludedArguments(&any_);
    closest_.flags = any_.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
#else
    rtcInitIntersectContext(&context_);
    context_.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
#endif
  }
  void closest(const int* valid, RTCRayHit16* rays) {
#ifdef GLEANER_EMBREE4
    rtcIntersect16(valid, scene_, rays, &closest_);
#else
    rtcIntersect16(valid, scene_, &context_, rays);
#endif
  }
  void any(const int* valid, RTCRay16* rays) {
#ifdef GLEANER_EMBREE4
    rtcOccluded16(valid, scene_, rays, &any_);
#else
    rtcOccluded16(valid, scene_, &context_, rays);
#endif
  }

 private:
  RTCScene scene_;
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

class EmbreeTracer final : public Tracer {
 public:
  EmbreeTracer(const scene::Scene& scene, unsigned threads) {
    device_ = rtcNewDevice(("threads=" + std::to_string(threads)).c_str());
    if (!device_) throw Error::failed("Embree: no device (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
    scene_ = rtcNewScene(device_);
    // Robust: watertight at shared edges. Medium: the high-quality build is not deterministic.
    rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_MEDIUM);
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    if (!scene.indices.empty()) {
      void* vertices =
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, scene.vertex_count());
      void* indices =
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, scene.triangle_count());
      if (vertices && indices) {
        std::memcpy(vertices, scene.positions.data(), scene.positions.size() * sizeof(float));
        std::memcpy(indices, scene.indices.data(), scene.indices.size() * sizeof(std::uint32_t));
      }
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_);
    if (auto error = rtcGetDeviceError(device_); error != RTC_ERROR_NONE) {
      release();
      throw Error::failed("Embree: building the scene failed (error " + std::to_string(error) + ")");
    }
  }
  ~EmbreeTracer() override { release(); }

  void closest(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    walk(queue, rays, range, [](Query& query, const Valid& valid, float* block, RTCScene scene) {
      auto* hit = reinterpret_cast<RTCRayHit16*>(block);
      query.closest(valid.lanes, hit);
      retrace_self_hits(hit, valid, scene);
    });
  }

  void any(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    walk(queue, rays, range, [](Query& query, const Valid& valid, float* block, RTCScene) {
      query.any(valid.lanes, reinterpret_cast<RTCRay16*>(block));
    });
  }

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
        visit(query, asking(block, count - i), block, scene_);
      }
    };
    run(Query(scene_, false), 0, range.incoherent);
    run(Query(scene_, true), range.coherent_base, range.coherent_count);
    _mm_setcsr(control);
  }

  // A plane is never left through itself: where rounding says so all the same, the search goes on behind that hit.
  static void retrace_self_hits(RTCRayHit16* rays, const Valid& valid, RTCScene scene) {
    // All lanes at once, so that the compiler makes vector code of it; a hit on the source is next to never.
    std::uint32_t self = 0;
    for (std::uint32_t k = 0; k < 16; ++k)
      self |= static_cast<std::uint32_t>(valid.lanes[k] && rays->hit.geomID[k] != RTC_INVALID_GEOMETRY_ID &&
                                         rays->hit.primID[k] == rays->ray.id[k])
              << k;
    while (self) {
      const int lane = __builtin_ctz(self);
      self &= self - 1;
      Query query(scene, false);
      for (int tries = 0; tries < 4 && rays->hit.geomID[lane] != RTC_INVALID_GEOMETRY_ID &&
                          rays->hit.primID[lane] == rays->ray.id[lane];
           ++tries) {
        rays->ray.tnear[lane] = std::nextafter(rays->ray.tfar[lane], std::numeric_limits<float>::infinity());
        rays->ray.tfar[lane] = std::numeric_limits<float>::infinity();
        rays->hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
        Valid one{};
        one.lanes[lane] = -1;
        query.closest(one.lanes, rays);
      }
    }
  }

  void release() {
    if (scene_) rtcReleaseScene(scene_);
    if (device_) rtcReleaseDevice(device_);
  }

  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
};

}  // namespace

bool embree_available() { return true; }

std::unique_ptr<Tracer> make_embree_tracer(const scene::Scene& scene, unsigned threads) {
  return std::make_unique<EmbreeTracer>(scene, threads);
}

}  // namespace gleaner::worker
