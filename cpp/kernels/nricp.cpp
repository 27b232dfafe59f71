#include "kernels/nricp.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/turns.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"
#include "geometry/nodes.h"
#include "geometry/weld.h"
#include "kernels/nricp/check.h"
#include "kernels/nricp/fine.h"
#include "kernels/nricp/graph.h"
#include "kernels/nricp/match.h"

namespace toile {

namespace {

using std::to_string;

/// Geometric from `a` to `b` as i runs over [0, count).
double anneal(double a, double b, int i, int count) {
    return count > 1 ? a * std::pow(b / a, static_cast<double>(i) / (count - 1)) : b;
}

/// A third of the faces' areas to each vertex, as shares of the whole.
Vector area_shares(const Vertices& V, const Faces& F) {
    const Vector areas = face_areas(V, F);
    Vector share = Vector::Zero(V.rows());
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) share[F(f, c)] += areas[f] / 3;
    return share / areas.sum();
}

/// 1 where at least `least` of the rays from a vertex leave the template, else 0: cavities are never scanned.
Vector visible_vertices(const Vertices& V, const Faces& F, const Vertices& normals, double least) {
    if (least <= 0) return Vector::Ones(V.rows());
    constexpr int rays = 48;
    const SurfaceIndex index(V, F);
    Vector visible(V.rows());
    parallel_for(V.rows(), [&](std::int64_t v) {
        const Vec3 n = normals.row(v).transpose();
        visible[v] = 0;
        if (n.isZero(0)) return;  // no face uses it
        const Vec3 origin = V.row(v).transpose() + 1e-4 * n;
        const double enough = least * rays;
        int free = 0;
        for (int i = 0; i < rays && free < enough; ++i) {  // Fibonacci sphere, folded to the side of the normal
            const double z = 1 - (2 * i + 1.0) / rays, r = std::sqrt(1 - z * z), a = i * M_PI * (3 - std::sqrt(5.0));
            const Vec3 d(r * std::cos(a), r * std::sin(a), z);
            free += !index.occluded(origin, d.dot(n) < 0 ? Vec3(-d) : d, 1e-4);
        }
        visible[v] = free >= enough;
    });
    return visible.sum() > 0 ? visible : Vector::Ones(V.rows());
}

}  // namespace

NricpOptions nricp_preset(const std::string& name) {
    NricpOptions o;
    if (name == "draft") {
        o.iterations = {5, 5, 0};
        o.fine_iterations = 0;
    } else if (name == "fine") {
        o.iterations = {10, 10, 20};
        o.settled = {0, 0, 0};
        o.fine_iterations = 5;
        o.fine_sweeps = 10;
    } else {
        require(name == "standard", "nricp: preset is '" + name + "', expected draft, standard or fine");
    }
    return o;
}

/// One level of the coarse solve.
struct Level {
    std::size_t number;  ///< into the options' lists
    NricpGraph graph;
    Samples samples;
};

/// Works in the template's own frame: about its mean, sized so that its area is 1.
struct NricpSolver::State {
    NricpOptions options;
    Faces F;
    Vec3 middle;
    double size;
    Vertices V, N;
    std::vector<int> to;  ///< the vertex that a vertex is welded to; empty: none is
    std::vector<Level> levels;
    TemplateBorders borders;
    std::optional<Samples> all;  ///< every visible vertex, for the fine steps
    std::optional<NricpFine> fine;
    Turn::Holder busy{0};  ///< graphs and factors hold the frame under way: one solve at a time

    Vertices into(const Vertices& x) const { return (x.rowwise() - middle.transpose()) / size; }
    Vertices out_of(const Vertices& x) const { return (x * size).rowwise() + middle.transpose(); }
    NricpFrame into(const NricpFrame& frame) const;
};

NricpFrame NricpSolver::State::into(const NricpFrame& frame) const {
    NricpFrame f = frame;
    f.V = into(frame.V);
    f.F = target_faces(f, options.labels);
    if (frame.start.rows() > 0) f.start = into(frame.start);
    if (frame.landmarks.P.rows() > 0) f.landmarks.P = into(frame.landmarks.P);
    constexpr double exact = 1e-4;  // a landmark of less than this is met, and a smaller one spoils the factor
    f.landmarks.sigma = (f.landmarks.sigma / size).cwiseMax(exact);
    for (NricpLoop& loop : f.loops) loop.polyline = into(loop.polyline);
    if (to.empty()) return f;
    for (NricpLoop& loop : f.loops) loop.vertices = loop.vertices.unaryExpr([&](int v) { return to[v]; }).eval();
    std::vector<Eigen::Triplet<double>> entries;
    for (int i = 0; i < f.landmarks.W.outerSize(); ++i)
        for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator r(f.landmarks.W, i); r; ++r)
            entries.emplace_back(i, to[r.col()], r.value());
    f.landmarks.W.setFromTriplets(entries.begin(), entries.end());
    return f;
}

namespace {

/// The visible vertices, thinned so that each lies within `spacing` of one that is kept and stands for its area.
Samples samples_of(const Vertices& V, const Vertices& N, const GeodesicGraph& surface, const Vector& area,
                   double spacing) {
    Vector share = Vector::Zero(V.rows());
    std::vector<int> stands(static_cast<std::size_t>(V.rows()), -1);
    const Cover thinned = spacing > 0 ? cover(surface, spacing) : Cover{};
    std::vector<int> chosen(thinned.vertex.size(), -1);  // a cell's centre, or its first vertex if that has no area
    for (int v = 0; v < V.rows(); ++v) {
        if (area[v] <= 0) continue;
        stands[v] = v;
        if (spacing > 0) {
            const int cell = thinned.owner[v], centre = thinned.vertex[cell];
            if (chosen[cell] < 0) chosen[cell] = area[centre] > 0 ? centre : v;
            stands[v] = chosen[cell];
        }
        share[stands[v]] += area[v];
    }
    std::vector<int> vertex;
    std::vector<double> kept;
    for (int v = 0; v < V.rows(); ++v)
        if (share[v] > 0 && area[v] > 0) {
            vertex.push_back(v);
            kept.push_back(share[v]);
        }
    return {V, N, std::move(vertex), std::move(kept), std::move(stands)};
}

std::vector<int> merged(const std::vector<int>& a, const std::vector<int>& b) {
    std::vector<int> both;
    std::set_union(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
    return both;
}

/// One frame's solve: the pose, evidence, and the match of each step.
struct Progress {
    const NricpFrame& frame;
    const NricpTarget& target;
    const NricpOptions& options;
    Matcher matcher;
    Pose pose;
    NricpResult result;
    double last_move = INFINITY;

    bool still() const { return last_move < 1e-4; }  ///< of the template's size

    /// False when nothing overlaps; landmarks may still be pulling the template there.
    bool match(Samples& samples, const MatchSettings& settings, Pull& pull) {
        pull = matcher.pull(pose, samples, settings);
        result.energy.push_back(pull.energy);
        result.rms = pull.rms;
        result.matched = pull.matched;
        return pull.overlap >= options.min_overlap || frame.landmarks.W.rows() > 0;
    }
    void move_to(Pose next) {
        double sum = 0;  // of vertices that faces use
        int count = 0;
        for (Eigen::Index v = 0; v < pose.V.rows(); ++v)
            if (pose.N.row(v).any()) {
                sum += (next.V.row(v) - pose.V.row(v)).squaredNorm();
                ++count;
            }
        last_move = std::sqrt(sum / std::max(count, 1));
        pose = std::move(next);
        ++result.iterations;
    }
    MatchSettings coarse(std::size_t level, double mu, bool local) const {
        const NricpOptions& o = options;
        const bool surface = level + 1 == o.relative_radii.size();
        return {mu,      o.relative_spread[level], o.reverse[level],  local,          surface,
                o.phong, o.point_weight,           o.boundary_weight, o.border_weight};
    }
    MatchSettings fine() const {
        const NricpOptions& o = options;
        return {o.relative_fine_robust, o.relative_spread.back(), 0, true, true, o.phong, o.point_weight,
                o.boundary_weight,      o.border_weight};
    }
};

/// One Gauss-Newton step of a rigid motion of everything.
Pose rigid_step(const Pose& pose, const Pull& pull) {
    Eigen::RowVector3d middle = Eigen::RowVector3d::Zero();  // of what is pulled: a stray vertex must not move it
    double weight = 0;
    for (Eigen::Index v = 0; v < pose.V.rows(); ++v) {
        middle += pull.A[v].trace() * pose.V.row(v);
        weight += pull.A[v].trace();
    }
    middle /= std::max(weight, 1e-300);
    Eigen::Matrix<double, 6, 6> H = 1e-9 * Eigen::Matrix<double, 6, 6>::Identity();
    Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
    for (Eigen::Index v = 0; v < pose.V.rows(); ++v) {
        if (pull.A[v].isZero(0)) continue;
        const Vec3 a = (pose.V.row(v) - middle).transpose();
        Eigen::Matrix<double, 3, 6> J;
        J << 0, a.z(), -a.y(), 1, 0, 0, -a.z(), 0, a.x(), 0, 1, 0, a.y(), -a.x(), 0, 0, 0, 1;
        H += J.transpose() * pull.A[v] * J;
        g += J.transpose() * pull.b.row(v).transpose();
    }
    const Eigen::Matrix<double, 6, 1> s = H.ldlt().solve(g);
    const double angle = s.head<3>().norm();
    const Mat3 R = angle > 0 ? Eigen::AngleAxisd(angle, s.head<3>() / angle).toRotationMatrix() : Mat3::Identity();
    const Eigen::RowVector3d moved = middle + s.tail<3>().transpose();
    return {((pose.V.rowwise() - middle) * R.transpose()).rowwise() + moved, pose.N * R.transpose()};
}

bool run_rigid(Progress& p, Samples& samples) {
    constexpr int steps = 10;
    constexpr double still = 1e-3;
    Pull pull;
    for (int i = 0; i < steps && p.last_move > still; ++i) {
        if (!p.match(samples, p.coarse(0, p.options.relative_robust_start[0], false), pull)) return false;
        p.move_to(rigid_step(p.pose, pull));
    }
    return true;
}

bool run_graph(Progress& p, Level& own, const Pose& rest) {
    const NricpOptions& o = p.options;
    const std::size_t level = own.number;
    own.graph.start(rest, p.pose.V);
    const std::vector<int> pulled = merged(own.samples.vertex, p.matcher.marked());
    own.graph.place(pulled, p.pose);
    Pull pull;
    const int count = o.iterations[level];
    for (int i = 0; i < count; ++i) {
        if (i > 0 && p.last_move < o.settled[level] * o.relative_radii[level]) i = count - 1;
        const double mu = anneal(o.relative_robust_start[level], o.relative_robust_end[level], i, count);
        const bool local = i > 1 && level + 1 == o.relative_radii.size();
        if (!p.match(own.samples, p.coarse(level, mu, local), pull)) return false;
        const double stiffness = anneal(o.stiffness_start[level], o.stiffness_end[level], i, count);
        own.graph.step(pull, p.pose.V, stiffness, o.rotation_weight);
        Pose next = p.pose;
        own.graph.place(pulled, next);
        p.move_to(std::move(next));
    }
    p.pose = own.graph.pose();
    return true;
}

bool run_fine(Progress& p, NricpFine& fine, Samples& all, const Faces& F) {
    const NricpOptions& o = p.options;
    const double length = o.relative_fine_length + o.fine_noise * p.target.noise();
    const Vertices anchor = p.pose.V;
    Pull pull;
    for (int i = 0; i < o.fine_iterations && (i == 0 || !p.still()); ++i) {
        if (!p.match(all, p.fine(), pull)) return false;
        Vertices x = fine.step(anchor, p.pose.V, pull, length, o.fine_sweeps);
        p.move_to({x, vertex_normals(x, F)});
    }
    return true;
}

}  // namespace

NricpSolver::NricpSolver(const Vertices& V, const Faces& given, const NricpOptions& options)
    : state_(std::make_unique<State>()) {
    check_options(options);
    check_mesh("nricp", V, given);
    check_size("V", V);
    State& s = *state_;
    s.options = options;
    Welded welded = weld(V, given);
    require(welded.F.rows() > 0, "nricp: F has no face of three different vertices");
    s.F = std::move(welded.F);
    s.to = std::move(welded.to);
    const Faces& F = s.F;
    Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) sum += V.row(F(f, c)) - V.row(F(0, 0));
    s.middle = (V.row(F(0, 0)) + sum / (3.0 * F.rows())).transpose();
    s.size = std::sqrt(face_areas(V.rowwise() - s.middle.transpose(), F).sum());
    require(s.size > 1 / largest_length, "nricp: the faces F of V have no area");
    s.V = s.into(V);
    s.N = vertex_normals(s.V, F);
    const Vector area = area_shares(s.V, F), seen = area.cwiseProduct(visible_vertices(s.V, F, s.N, options.exposure));
    s.borders = TemplateBorders(s.V, s.N, F, seen);
    if (options.border_weight <= 0) s.borders.curves.clear();  // nothing pulls: the scan's are not looked for
    const GeodesicGraph surface(s.V, F);
    for (std::size_t level = options.large_motion ? 0 : 1; level < options.relative_radii.size(); ++level)
        if (options.iterations[level] > 0) {
            Samples samples = samples_of(s.V, s.N, surface, seen, options.relative_detail[level]);
            const double radius =
                std::max(options.relative_radii[level], 0.75 * surface.median_length());  // nodes must share vertices
            s.levels.push_back(
                {level, {surface, radius, merged(samples.vertex, s.borders.vertices)}, std::move(samples)});
        }
    s.all.emplace(samples_of(s.V, s.N, surface, seen, 0));
    if (options.fine_iterations > 0) s.fine.emplace(s.V, F, area);
}

NricpSolver::~NricpSolver() = default;
NricpSolver::NricpSolver(NricpSolver&&) noexcept = default;

NricpResult NricpSolver::solve(const NricpFrame& given) {
    State& s = *state_;
    const Turn turn(s.busy, "nricp");
    const NricpOptions& o = s.options;
    check_frame(given, s.V.rows(), o);
    const NricpFrame frame = s.into(given);
    NricpResult none;
    none.V = Vertices::Constant(s.V.rows(), 3, std::numeric_limits<double>::quiet_NaN());
    none.rms = std::numeric_limits<double>::quiet_NaN();
    none.matched = Vector::Zero(s.V.rows());
    none.stop = Stop::no_overlap;
    if (frame.F.rows() == 0) return none;

    NricpTarget target(frame.V, frame.F, frame.confidence);
    const Vertices start = frame.start.rows() > 0 ? frame.start : s.V;
    const Vertices start_N = vertex_normals(start, s.F);
    Samples& widest = s.levels.empty() ? *s.all : s.levels.front().samples;
    target.orient(widest, {start, start_N});
    Progress p{frame, target, o, {frame, target, s.borders, start.rows()}, {start, start_N}, {}};
    bool overlaps = true;
    for (int pass = 0; overlaps && pass < o.passes; ++pass) {
        const Pose rest = pass > 0 || o.rebase ? p.pose : Pose{s.V, s.N};
        if (o.large_motion) overlaps = run_rigid(p, widest);
        for (Level& level : s.levels) overlaps = overlaps && run_graph(p, level, rest);
        if (s.fine) overlaps = overlaps && run_fine(p, *s.fine, *s.all, s.F);
    }
    Pull last;
    Samples& finest = s.fine || s.levels.empty() ? *s.all : s.levels.back().samples;
    overlaps = overlaps && (p.match(finest, p.fine(), last), last.overlap >= o.min_overlap);
    none.iterations = p.result.iterations;
    if (!overlaps) return none;
    p.result.stop = p.still() ? Stop::converged : Stop::max_iterations;
    p.result.V = s.out_of(p.pose.V);
    for (Eigen::Index v = 0; v < last.matched.size(); ++v)
        if (const int w = finest.stands[v]; w >= 0) p.result.matched[v] = std::max(last.matched[v], last.matched[w]);
    for (std::size_t v = 0; v < s.to.size(); ++v) {
        p.result.V.row(v) = p.result.V.row(s.to[v]);
        p.result.matched[v] = p.result.matched[s.to[v]];
    }
    p.result.rms *= s.size;
    check_solved("nricp", "V", p.result.V);
    for (double& e : p.result.energy) e *= s.size * s.size;
    return p.result;
}

std::int64_t NricpSolver::analyses() const {
    const Turn turn(state_->busy, "nricp");
    std::int64_t sum = state_->fine ? state_->fine->analyses() : 0;
    for (const Level& l : state_->levels) sum += l.graph.system.factor.analyses();
    return sum;
}

std::int64_t NricpSolver::factorisations() const {
    const Turn turn(state_->busy, "nricp");
    std::int64_t sum = state_->fine ? state_->fine->factorisations() : 0;
    for (const Level& l : state_->levels) sum += l.graph.system.factor.factorisations();
    return sum;
}

}  // namespace toile
