#include "geometry/closest.h"

#include <embree3/rtcore.h>
#include <pthread.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <mutex>
#include <thread>
#include <vector>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/topology.h"

namespace toile {

SurfacePoint closest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
    auto answer = [&](double u, double v, double w) {
        SurfacePoint s;
        s.barycentric = Vec3(u, v, w);
        s.point = u * a + v * b + w * c;
        s.distance = (p - s.point).norm();
        return s;
    };
    const Vec3 ab = b - a, ac = c - a, ap = p - a;
    const double d1 = ab.dot(ap), d2 = ac.dot(ap);
    if (d1 <= 0 && d2 <= 0) return answer(1, 0, 0);
    const Vec3 bp = p - b;
    const double d3 = ab.dot(bp), d4 = ac.dot(bp);
    if (d3 >= 0 && d4 <= d3) return answer(0, 1, 0);
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) {  // an edge of no length leaves it to the others
        const double t = d1 / (d1 - d3);
        return answer(1 - t, t, 0);
    }
    const Vec3 cp = p - c;
    const double d5 = ab.dot(cp), d6 = ac.dot(cp);
    if (d6 >= 0 && d5 <= d6) return answer(0, 0, 1);
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) {
        const double t = d2 / (d2 - d6);
        return answer(1 - t, 0, t);
    }
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        const double t = d4 > d3 ? (d4 - d3) / ((d4 - d3) + (d5 - d6)) : 0;
        return answer(0, 1 - t, t);
    }
    const double sum = va + vb + vc;
    if (sum > 1e-6 * ab.squaredNorm() * ac.squaredNorm()) return answer(va / sum, vb / sum, vc / sum);
    // With a corner all but on the opposite edge va, vb and vc are mostly rounding: the nearest may lie on any edge.
    SurfacePoint best = std::min({va, vb, vc}) > 0 ? answer(va / sum, vb / sum, vc / sum) : answer(1, 0, 0);
    const auto along = [&](const Vec3& from, const Vec3& edge) {
        const double square = edge.squaredNorm();
        return square > 0 ? std::clamp((p - from).dot(edge) / square, 0.0, 1.0) : 0;
    };
    const double t = along(a, ab), u = along(b, c - b), v = along(a, ac);
    for (const SurfacePoint& on_edge : {answer(1 - t, t, 0), answer(0, 1 - u, u), answer(1 - v, 0, v)})
        if (on_edge.distance < best.distance) best = on_edge;
    return best;
}

namespace {

/// Embree's devices that build no tree at present. A device takes one of the process' 1024 keys for storage of threads, and
/// builds one tree at a time: there are as many as trees were ever built at once. A process is forked when none is built:
/// TBB, by which Embree builds, has locks that a child would find held by threads that it has not.
class Devices {
public:
    RTCDevice take() {
        const std::lock_guard gate(gate_);
        const std::lock_guard lock(idle_mutex_);
        RTCDevice device = nullptr;
        if (idle_.empty()) {
            device = rtcNewDevice("threads=1");
            if (!device) throw SolveError("closest: Embree gives no device on this machine");
        } else {
            device = idle_.back();
            idle_.pop_back();
        }
        ++building_;
        return device;
    }
    void give_back(RTCDevice device) {
        {
            const std::lock_guard lock(idle_mutex_);
            idle_.push_back(device);
        }
        --building_;
    }
    /// Returns when no tree is built; none is begun before `go_on`, in the parent and in the child.
    void rest() {
        gate_.lock();
        while (building_ > 0) std::this_thread::sleep_for(std::chrono::microseconds(50));
    }
    void go_on() { gate_.unlock(); }

private:
    std::mutex gate_, idle_mutex_;
    std::atomic<int> building_ = 0;
    std::vector<RTCDevice> idle_;
};

Devices& devices = *new Devices;  // never destroyed: trees outlive static objects
[[maybe_unused]] const int handler =
    pthread_atfork([] { devices.rest(); }, [] { devices.go_on(); }, [] { devices.go_on(); });

constexpr const char* no_memory = "closest: Embree built no tree: out of memory";

/// A device for as long as a tree is built on it.
struct Device {
    RTCDevice device = devices.take();
    Device() { rtcGetDeviceError(device); }  // forgets what an earlier tree of this thread left
    ~Device() { devices.give_back(device); }
    Device(const Device&) = delete;
    Device& operator=(const Device&) = delete;
};

}  // namespace

struct SurfaceIndex::State {
    Vertices V;
    Faces F;
    Vec3 centre = Vec3::Zero();
    double scale = 1;  // world metres per local unit
    RTCScene scene = nullptr;

    ~State() {
        if (scene) rtcReleaseScene(scene);
    }
    Vec3 corner(int face, int c) const { return V.row(F(face, c)); }
    Vec3 to_local(const Vec3& p) const { return (p - centre) / scale; }
};

namespace {

// The box of *referenced* vertices: one stray vertex must not cost the others their precision.
void fit_frame(const Vertices& V, const Faces& F, Vec3& centre, double& scale) {
    Eigen::AlignedBox3d box;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) box.extend(Vec3(V.row(F(f, c))));
    centre = box.center();
    scale = std::max(box.diagonal().norm(), std::numeric_limits<double>::min() * 1e10);
}

/// Squares of local coordinates overflow float32 beyond.
bool beyond_float(const Vec3& local) { return !(local.cwiseAbs().maxCoeff() < 1e15); }

struct Query {
    const Vertices* V;
    const Faces* F;
    Vec3 p;  // world
    double scale;
    SurfacePoint best;
};

bool take_if_nearer(Query& q, int face) {
    const Faces& F = *q.F;
    SurfacePoint s = closest_on_triangle(q.p, q.V->row(F(face, 0)), q.V->row(F(face, 1)), q.V->row(F(face, 2)));
    const bool nearer = q.best.face < 0
                            ? s.distance <= q.best.distance
                            : s.distance < q.best.distance || (s.distance == q.best.distance && face < q.best.face);
    if (!nearer) return false;
    s.face = face;
    q.best = s;
    return true;
}

bool visit_face(RTCPointQueryFunctionArguments* args) {
    auto& q = *static_cast<Query*>(args->userPtr);
    if (!take_if_nearer(q, static_cast<int>(args->primID))) return false;
    // Kept a little wider than the hit, so that float32 bounds never hide a face that ties in double.
    const float radius = static_cast<float>(q.best.distance / q.scale * (1 + 1e-6) + 1e-7);
    if (radius >= args->query->radius) return false;
    args->query->radius = radius;
    return true;
}

}  // namespace

SurfaceIndex::SurfaceIndex(const Vertices& V, const Faces& F) : state_(std::make_unique<State>()) {
    State& s = *state_;
    s.V = V;
    s.F = F;
    fit_frame(V, F, s.centre, s.scale);
    const Device own;
    s.scene = rtcNewScene(own.device);
    rtcSetSceneFlags(s.scene, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(s.scene, RTC_BUILD_QUALITY_LOW);  // most trees serve few queries: a quick build pays
    RTCGeometry mesh = rtcNewGeometry(own.device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertex = static_cast<float*>(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                               3 * sizeof(float), static_cast<std::size_t>(V.rows())));
    auto* index = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
        mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), static_cast<std::size_t>(F.rows())));
    if (!vertex || !index) {
        rtcReleaseGeometry(mesh);
        throw SolveError(no_memory);
    }
    for (Eigen::Index v = 0; v < V.rows(); ++v) {
        const Vec3 p = s.to_local(V.row(v));
        for (int c = 0; c < 3; ++c) vertex[3 * v + c] = static_cast<float>(p[c]);
    }
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) index[3 * f + c] = static_cast<unsigned>(F(f, c));
    rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_LOW);
    rtcCommitGeometry(mesh);
    rtcAttachGeometry(s.scene, mesh);
    rtcReleaseGeometry(mesh);
    rtcCommitScene(s.scene);
    if (rtcGetDeviceError(own.device) != RTC_ERROR_NONE) throw SolveError(no_memory);
}

SurfaceIndex::~SurfaceIndex() = default;
SurfaceIndex::SurfaceIndex(SurfaceIndex&&) noexcept = default;
SurfaceIndex& SurfaceIndex::operator=(SurfaceIndex&&) noexcept = default;

SurfacePoint SurfaceIndex::closest(const Vec3& p, double radius, int guess) const {
    const State& s = *state_;
    Query q{&s.V, &s.F, p, s.scale, {}};
    q.best.distance = radius;
    if (guess >= 0) take_if_nearer(q, guess);
    const Vec3 local = s.to_local(p);
    if (beyond_float(local)) {
        for (int f = 0; f < s.F.rows(); ++f) take_if_nearer(q, f);
        return q.best;
    }
    RTCPointQuery query{};
    query.x = static_cast<float>(local[0]);
    query.y = static_cast<float>(local[1]);
    query.z = static_cast<float>(local[2]);
    const double wide = q.best.distance / s.scale * (1 + 1e-6) + 1e-6;
    query.radius = wide < 1e30 ? static_cast<float>(wide) : std::numeric_limits<float>::infinity();
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(s.scene, &query, &context, visit_face, &q);
    return q.best;
}

std::vector<SurfacePoint> SurfaceIndex::closest_each(const Vertices& points, double radius,
                                                     const Indices& guesses) const {
    require(
        guesses.size() == 0 || guesses.size() == points.rows(),
        "closest: guess has " + std::to_string(guesses.size()) + " entries, points " + std::to_string(points.rows()));
    for (Eigen::Index i = 0; i < guesses.size(); ++i)
        require(guesses[i] < state_->F.rows(), "closest: guess[" + std::to_string(i) + "] is face " +
                                                   std::to_string(guesses[i]) + " of " +
                                                   std::to_string(state_->F.rows()));
    std::vector<SurfacePoint> out(static_cast<std::size_t>(points.rows()));
    constexpr std::int64_t run = 256;  // points in a row often lie side by side: one's face is the next one's guess
    parallel_for((points.rows() + run - 1) / run, [&](std::int64_t b) {
        int last = -1;
        for (std::int64_t i = b * run, end = std::min<std::int64_t>(points.rows(), i + run); i < end; ++i) {
            SurfacePoint& hit = out[static_cast<std::size_t>(i)];
            hit = closest(Vec3(points.row(i)), radius, guesses.size() > 0 ? guesses[i] : last);
            if (hit.face >= 0) last = hit.face;
        }
    }, 1);
    return out;
}

namespace {

SurfacePoint on_face(const Vec3& p, int face, const Vertices& V, const Faces& F) {
    SurfacePoint s = closest_on_triangle(p, V.row(F(face, 0)), V.row(F(face, 1)), V.row(F(face, 2)));
    s.face = face;
    return s;
}

/// Of the faces about the corners that a place on its face's border touches, the one with the nearest point to p.
SurfacePoint next_towards(const Vec3& p, const SurfacePoint& at, const Vertices& V, const Faces& F,
                          const Adjacency& about) {
    SurfacePoint best = at;
    if (at.barycentric.minCoeff() > 0) return best;
    for (int c = 0; c < 3; ++c) {
        if (!(at.barycentric[c] > 0)) continue;
        const int v = F(at.face, c);
        for (int i = about.start[v]; i < about.start[v + 1]; ++i) {
            const SurfacePoint s = on_face(p, about.index[i], V, F);
            if (s.distance < best.distance) best = s;
        }
    }
    return best;
}

}  // namespace

std::vector<SurfacePoint> SurfaceIndex::reached_each(const Vertices& points, const Indices& start) const {
    const Vertices& V = state_->V;
    const Faces& F = state_->F;
    require(start.size() == points.rows(),
            "reached: start has " + std::to_string(start.size()) + " entries, points " + std::to_string(points.rows()));
    for (Eigen::Index i = 0; i < start.size(); ++i)
        require(start[i] >= 0 && start[i] < F.rows(), "reached: start[" + std::to_string(i) + "] is face " +
                                                          std::to_string(start[i]) + " of " + std::to_string(F.rows()));
    const Adjacency about = vertex_faces(F, V.rows());
    std::vector<SurfacePoint> out(static_cast<std::size_t>(points.rows()));
    parallel_for(points.rows(), [&](std::int64_t i) {
        const Vec3 p = points.row(i);
        SurfacePoint at = on_face(p, start[i], V, F);
        for (SurfacePoint next = next_towards(p, at, V, F, about); next.face != at.face;
             next = next_towards(p, at, V, F, about))
            at = next;
        out[static_cast<std::size_t>(i)] = at;
    }, 256);
    return out;
}

namespace {

RTCRay local_ray(const Vec3& origin, const Vec3& direction, double from, double to, double scale) {
    RTCRay ray{};
    ray.org_x = static_cast<float>(origin[0]);
    ray.org_y = static_cast<float>(origin[1]);
    ray.org_z = static_cast<float>(origin[2]);
    ray.dir_x = static_cast<float>(direction[0]);
    ray.dir_y = static_cast<float>(direction[1]);
    ray.dir_z = static_cast<float>(direction[2]);
    ray.tnear = static_cast<float>(from / scale);
    ray.tfar = static_cast<float>(std::min(to / scale, 1e30));
    ray.mask = 0xffffffffu;
    return ray;
}

}  // namespace

RayHit SurfaceIndex::first_hit(const Vec3& origin, const Vec3& direction, double from, double to) const {
    const State& s = *state_;
    const Vec3 d = direction.normalized(), local = s.to_local(origin);
    if (beyond_float(local)) return {};
    RTCRayHit hit{};
    hit.ray = local_ray(local, d, from, to, s.scale);
    hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(s.scene, &context, &hit);
    RayHit out;
    if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID) return out;
    out.face = static_cast<int>(hit.hit.primID);
    const Vec3 a = s.corner(out.face, 0), n = (s.corner(out.face, 1) - a).cross(s.corner(out.face, 2) - a);
    const double slope = n.dot(d);
    out.distance = slope != 0 ? n.dot(a - origin) / slope : static_cast<double>(hit.ray.tfar) * s.scale;
    return out;
}

bool SurfaceIndex::occluded(const Vec3& origin, const Vec3& direction, double from, double to) const {
    const State& s = *state_;
    const Vec3 local = s.to_local(origin);
    if (beyond_float(local)) return false;
    RTCRay ray = local_ray(local, direction.normalized(), from, to, s.scale);
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(s.scene, &context, &ray);
    return ray.tfar < 0;
}

int SurfaceIndex::occluded_of(const Vec3& origin, const Vec3* directions, int count, double to) const {
    const State& s = *state_;
    const Vec3 local = s.to_local(origin);
    if (beyond_float(local)) return 0;
    alignas(32) int valid[packet];
    alignas(32) RTCRay8 rays{};
    for (int k = 0; k < packet; ++k) {
        valid[k] = k < count ? -1 : 0;
        const RTCRay ray = local_ray(local, directions[std::min(k, count - 1)], 0, to, s.scale);
        rays.org_x[k] = ray.org_x, rays.org_y[k] = ray.org_y, rays.org_z[k] = ray.org_z;
        rays.dir_x[k] = ray.dir_x, rays.dir_y[k] = ray.dir_y, rays.dir_z[k] = ray.dir_z;
        rays.tnear[k] = ray.tnear, rays.tfar[k] = ray.tfar, rays.mask[k] = ray.mask;
    }
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded8(valid, s.scene, &context, &rays);
    return static_cast<int>(std::count_if(rays.tfar, rays.tfar + count, [](float t) { return t < 0; }));
}

double SurfaceIndex::diagonal() const { return state_->scale; }
const Vertices& SurfaceIndex::vertices() const { return state_->V; }
const Faces& SurfaceIndex::faces() const { return state_->F; }

}  // namespace toile
