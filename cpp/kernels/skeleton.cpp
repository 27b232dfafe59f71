#include "kernels/skeleton.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "base/errors.h"
#include "kernels/skeleton/problem.h"

namespace toile {

using namespace skeleton;

namespace {

Eigen::LLT<MatrixXd> damped_factor(const MatrixXd& H, double damping) {
    MatrixXd A = H;
    A.diagonal() *= 1 + damping;
    A.diagonal().array() += 1e-9 * std::max(1.0, H.diagonal().maxCoeff());
    Eigen::LLT<MatrixXd> factor(A);
    if (factor.info() != Eigen::Success) throw SolveError("skeleton: the normal equations are not positive definite");
    return factor;
}

struct Step {
    double size = 0;  // largest turn [rad] or move [m]
    double energy = 0;
};

/// One accepted Levenberg-Marquardt step, or none when no damping lowers the energy.
Step descend(const Problem& problem, BodyState& state, double& damping, System& system) {
    system = problem.linearise(state);
    for (int attempt = 0; attempt < 8; ++attempt) {
        const Vector x = -damped_factor(system.H, damping).solve(system.g);
        const BodyState next = problem.moved(state, x);
        const double energy = problem.energy(next);
        if (energy <= system.energy) {
            state = next;
            damping = std::max(damping * 0.2, 1e-7);
            return {x.cwiseAbs().maxCoeff(), energy};
        }
        damping = std::max(damping * 8, 1e-5);
    }
    return {0, system.energy};
}

/// Of the vertices that faces use.
Eigen::AlignedBox3d scan_box(const SkeletonFrame& f) {
    Eigen::AlignedBox3d box;
    for (Eigen::Index i = 0; i < f.scan_F.rows(); ++i)
        for (int c = 0; c < 3; ++c) box.extend(Vec3(f.scan_V.row(f.scan_F(i, c))));
    return box;
}

/// Rotation and translation of the root that take the model's keypoints at rest to the observed ones (Kabsch 1976).
void place_rigidly(const BodyModel& model, const SkeletonFrame& frame, BodyState& state) {
    const auto& kp = frame.keypoints;
    const PosedBody body(model, state, false);
    const Vec3 root = body.joint(0);
    if (kp.index.size() == 0) {
        const Vertices Y = body.vertices();
        state.translation +=
            scan_box(frame).center() - 0.5 * (Y.colwise().minCoeff() + Y.colwise().maxCoeff()).transpose();
        return;
    }
    Vertices P(kp.index.size(), 3);
    for (Eigen::Index i = 0; i < P.rows(); ++i) {
        const BodyKeypoint& k = model.keypoints[static_cast<std::size_t>(kp.index[i])];
        Vec3 y = Vec3::Zero();
        if (k.joint >= 0)
            y = body.joint(k.joint);
        else
            for (std::size_t j = 0; j < k.vertices.size(); ++j) y += k.weights[j] * body.vertex(k.vertices[j]);
        P.row(i) = y;
    }
    const Vec3 p = P.colwise().mean(), q = kp.points.colwise().mean();
    Mat3 R = Mat3::Identity();
    const Mat3 C = (P.rowwise() - p.transpose()).transpose() * (kp.points.rowwise() - q.transpose());
    Eigen::JacobiSVD<Mat3> svd(C, Eigen::ComputeFullU | Eigen::ComputeFullV);
    if (svd.singularValues()[1] > 1e-6) {
        Mat3 flip = Mat3::Identity();
        flip(2, 2) = (svd.matrixV() * svd.matrixU().transpose()).determinant() < 0 ? -1 : 1;
        R = svd.matrixV() * flip * svd.matrixU().transpose();
    }
    state.local[0] = R * state.local[0];
    state.translation += q - R * (p - root) - root;
}

BodyState state_of(const SkeletonPose& pose, const BodyModel& model) {
    BodyState state{rotation_matrices(pose.rotations), pose.translation, Vector::Zero(model.shapes())};
    state.shape.head(pose.shape.size()) = pose.shape;
    return state;
}

SkeletonPose pose_of(const BodyState& state) {
    SkeletonPose pose{Vertices(static_cast<Eigen::Index>(state.local.size()), 3), state.translation, state.shape};
    for (std::size_t k = 0; k < state.local.size(); ++k)
        pose.rotations.row(static_cast<Eigen::Index>(k)) = rotation_log(state.local[k]);
    return pose;
}

void check_pose(const std::string& name, const SkeletonPose& pose, const BodyModel& model) {
    require(pose.rotations.rows() == model.joints(), "skeleton: " + name + ".rotations has " +
                                                         std::to_string(pose.rotations.rows()) + " rows, the model " +
                                                         std::to_string(model.joints()) + " joints");
    check_finite("skeleton", name + ".rotations", pose.rotations);
    check_points("skeleton", name + ".translation", pose.translation);
    check_finite("skeleton", name + ".shape", pose.shape);
    require(pose.shape.size() <= model.shapes(), "skeleton: " + name + ".shape has " +
                                                     std::to_string(pose.shape.size()) + " entries, the model " +
                                                     std::to_string(model.shapes()));
}

/// The model is in metres: a scan in kilometres would lie within reach of some vertex and match it.
void check_span(const SkeletonFrame& f, const BodyModel& model) {
    const Eigen::AlignedBox3d box = scan_box(f);
    Eigen::AlignedBox3d body;
    for (Eigen::Index v = 0; v < model.v_template.rows(); ++v) body.extend(Vec3(model.v_template.row(v)));
    constexpr double least = 0.02, largest = 1e9;
    require(box.diagonal().norm() >= least * body.diagonal().norm(),
            "skeleton: the faces of scan_V span less than a fiftieth of the model; are its units metres?");
    require(box.min().cwiseAbs().maxCoeff() <= largest && box.max().cwiseAbs().maxCoeff() <= largest,
            "skeleton: the faces of scan_V reach beyond 1e9 m");
}

void check_frame(const SkeletonFrame& f, const BodyModel& model) {
    const auto& kp = f.keypoints;
    require(f.scan_F.rows() > 0 || kp.index.size() > 0,
            "skeleton: neither scan_F nor keypoints hold anything to fit to");
    require(f.scan_F.rows() > 0 || f.scan_V.rows() == 0,
            "skeleton: scan_F is empty, scan_V has " + std::to_string(f.scan_V.rows()) + " rows");
    if (f.scan_F.rows() > 0) check_mesh("skeleton", f.scan_V, f.scan_F, "scan_V", "scan_F");
    if (f.scan_F.rows() > 0) check_span(f, model);
    check_confidence("skeleton", "scan_confidence", f.scan_confidence, f.scan_V.rows());
    require(kp.index.size() == kp.points.rows() && kp.index.size() == kp.sigma.size(),
            "skeleton: keypoints have " + std::to_string(kp.index.size()) + " indices, " +
                std::to_string(kp.points.rows()) + " points, " + std::to_string(kp.sigma.size()) + " sigmas");
    check_indices("skeleton", "keypoints.index", kp.index, static_cast<Eigen::Index>(model.keypoints.size()));
    check_points("skeleton", "keypoints.points", kp.points);
    for (Eigen::Index i = 0; i < kp.sigma.size(); ++i)
        require(std::isfinite(kp.sigma[i]) && kp.sigma[i] > 0,
                "skeleton: keypoints.sigma[" + std::to_string(i) + "] must be positive");
    require(f.start.size() <= 1 && f.previous.size() <= 2, "skeleton: at most one start and two previous frames");
    for (const auto& p : f.start) check_pose("start", p, model);
    for (const auto& p : f.previous) check_pose("previous", p, model);
    require(f.clothed.size() == 0 || f.clothed.size() == model.v_template.rows(),
            "skeleton: clothed has " + std::to_string(f.clothed.size()) + " entries, the model " +
                std::to_string(model.v_template.rows()) + " vertices");
    for (Eigen::Index v = 0; v < f.clothed.size(); ++v)
        if (!(f.clothed[v] >= 0 && f.clothed[v] <= 1))
            throw InputError("skeleton: clothed[" + std::to_string(v) + "] must lie in [0, 1]");
}

/// A vertex's share of the area of all samples, so that the energy does not know how densely the model is sampled.
Vector area_shares(const BodyModel& model, const Vector& vertex_weights, const Indices& samples) {
    const Vector mass = voronoi_mass(model.v_template, model.F).cwiseProduct(vertex_weights);
    double total = 0;
    for (Eigen::Index i = 0; i < samples.size(); ++i) total += mass[samples[i]];
    require(total > 0, "skeleton: vertex_weights leave no area to fit");
    return mass / total;
}

void fit_keypoints(Problem& problem, BodyState& state, const SkeletonOptions& o) {
    double damping = 1e-2;
    System system;
    for (double widen : {8.0, 3.0, 1.0}) {
        problem.keypoint_robust = o.keypoint_robust_sigmas * widen;
        problem.surface_robust = 1;
        for (int i = 0; i < 15; ++i)
            if (descend(problem, state, damping, system).size < 1e-3) break;
    }
}

/// (K,3) a_k / twist_k: a_k points from joint k to the middle of its children at rest; 0 where twist_k is infinite or the
/// joint ends a limb.
Vertices twist_rows(const BodyModel& model, const Vector& twist) {
    Vertices rows = Vertices::Zero(model.joints(), 3);
    if (twist.size() == 0) return rows;
    for (int k = 1; k < model.joints(); ++k) {
        const int parent = model.parents[static_cast<std::size_t>(k)];
        rows.row(parent) += model.J.row(k) - model.J.row(parent);
    }
    for (int k = 0; k < model.joints(); ++k) rows.row(k) = rows.row(k).normalized() / twist[k];
    return rows;
}

}  // namespace

SkeletonSolver::SkeletonSolver(BodyModel model, Vector joint_sigma, Vector joint_limit, Vector vertex_weights,
                               SkeletonOptions options)
    : model_(std::move(model)), joint_sigma_(std::move(joint_sigma)), joint_limit_(std::move(joint_limit)),
      vertex_weights_(std::move(vertex_weights)), options_(options) {
    check_body_model("skeleton", model_);
    require(joint_sigma_.size() == model_.joints() && joint_limit_.size() == model_.joints(),
            "skeleton: joint_sigma and joint_limit need " + std::to_string(model_.joints()) + " entries");
    for (int k = 0; k < model_.joints(); ++k) {
        require(joint_sigma_[k] >= 0, "skeleton: joint_sigma[" + std::to_string(k) + "] must not be negative");
        require(joint_limit_[k] >= 0, "skeleton: joint_limit[" + std::to_string(k) + "] must not be negative");
    }
    const Vector& twist = options_.joint_twist;
    require(twist.size() == 0 || twist.size() == model_.joints(),
            "skeleton: joint_twist needs " + std::to_string(model_.joints()) + " entries, or none");
    for (Eigen::Index k = 0; k < twist.size(); ++k)
        require(twist[k] > 0, "skeleton: joint_twist[" + std::to_string(k) + "] must be positive");
    twist_ = twist_rows(model_, twist);
    require(vertex_weights_.size() == model_.v_template.rows(),
            "skeleton: vertex_weights has " + std::to_string(vertex_weights_.size()) + " entries, the model " +
                std::to_string(model_.v_template.rows()) + " vertices");
    std::vector<int> seen;
    for (Eigen::Index v = 0; v < vertex_weights_.size(); ++v) {
        if (!(std::isfinite(vertex_weights_[v]) && vertex_weights_[v] >= 0))
            throw InputError("skeleton: vertex_weights[" + std::to_string(v) + "] must not be negative");
        if (vertex_weights_[v] > 0) seen.push_back(static_cast<int>(v));
    }
    const SkeletonOptions& o = options_;
    require(o.surface_samples > 0 && o.max_iterations > 0 && o.idle > 0,
            "skeleton: surface_samples, max_iterations and idle must be positive");
    require(std::isfinite(o.relative_decrease) && o.relative_decrease >= 0 && o.relative_decrease < 1,
            "skeleton: relative_decrease must lie in [0, 1)");
    for (double positive : {o.surface_sigma, o.surface_robust, o.reach_start, o.reach, o.keypoint_robust_sigmas,
                            o.limit_sigma, o.temporal_sigma, o.temporal_translation, o.shape_weight, o.pose_weight})
        require(std::isfinite(positive) && positive > 0,
                "skeleton: sigmas, robust scales, reaches and prior weights must be positive");
    require(o.surface_weight >= 0 && o.cloth_fit >= 0 && std::isfinite(o.surface_weight) && std::isfinite(o.cloth_fit),
            "skeleton: surface_weight and cloth_fit must not be negative");
    require(std::isfinite(o.min_cosine) && std::isfinite(o.tolerance),
            "skeleton: min_cosine and tolerance must be finite");
    require(!seen.empty(), "skeleton: vertex_weights leave no vertex to fit");
    const std::size_t stride = std::max<std::size_t>(1, seen.size() / static_cast<std::size_t>(o.surface_samples));
    samples_.resize(static_cast<Eigen::Index>((seen.size() + stride - 1) / stride));
    for (Eigen::Index i = 0; i < samples_.size(); ++i) samples_[i] = seen[static_cast<std::size_t>(i) * stride];
    area_ = area_shares(model_, vertex_weights_, samples_);
    faces_of_ = vertex_faces(model_.F, model_.v_template.rows());
}

namespace {

SkeletonResult result_of(const BodyModel& model, const Problem& problem, const BodyState& state, const System& system) {
    SkeletonResult r;
    const PosedBody body = problem.posed(state);
    r.pose = pose_of(state);
    r.V = body.vertices();
    r.joints.resize(model.joints(), 3);
    for (int k = 0; k < model.joints(); ++k) r.joints.row(k) = body.joint(k);
    r.keypoint_rms = problem.keypoint_rms(body);
    r.matched = system.matched;
    r.rms = system.matched ? std::sqrt(system.squares / static_cast<double>(system.matched)) : 0;
    return r;
}

std::unique_ptr<ScanSurface> surface_of(const SkeletonFrame& frame) {
    return frame.scan_F.rows() ? std::make_unique<ScanSurface>(frame) : nullptr;
}

/// The frame, checked, without the faces of its scan that nothing vouches for.
SkeletonFrame trusted(const SkeletonFrame& given, const BodyModel& model) {
    check_frame(given, model);
    if (given.scan_confidence.size() == 0) return given;
    SkeletonFrame frame = given;
    frame.scan_F = trusted_faces(given.scan_F, given.scan_confidence);
    if (frame.scan_F.rows() == 0) {
        frame.scan_V.resize(0, 3);
        frame.scan_confidence.resize(0);
    }
    check_frame(frame, model);
    return frame;
}

}  // namespace

SkeletonResult SkeletonSolver::solve(const SkeletonFrame& given) const {
    const SkeletonFrame frame = trusted(given, model_);
    const auto scan = surface_of(frame);
    return solve_on(scan.get(), frame);
}

SkeletonResult SkeletonSolver::solve_on(const ScanSurface* scan, const SkeletonFrame& frame) const {
    const SkeletonOptions& o = options_;
    const bool warm = !frame.start.empty();
    BodyState state{std::vector<Mat3>(static_cast<std::size_t>(model_.joints()), Mat3::Identity()), Vec3::Zero(),
                    Vector::Zero(model_.shapes())};
    if (warm) state = state_of(frame.start[0], model_);
    Problem problem(model_, joint_sigma_, joint_limit_, twist_, area_, frame, o, o.solve_shape);
    if (!warm) {
        place_rigidly(model_, frame, state);
        if (frame.keypoints.index.size()) fit_keypoints(problem, state, o);
    }
    problem.keypoint_robust = o.keypoint_robust_sigmas;
    double reach = warm ? o.reach : std::max(o.reach, o.reach_start), damping = 1e-4;
    std::vector<double> energies;
    Stop stop = Stop::max_iterations;
    System system;
    Vertices before;
    std::vector<int> faces;  // of the scan, that the samples found last
    bool settled = false;    // the last step was taken within the final reach
    double least = std::numeric_limits<double>::infinity();
    int idle = 0;
    for (int i = 0; i < o.max_iterations; ++i) {
        problem.surface_robust = o.surface_robust * reach / o.reach;
        const Vertices Y = problem.posed(state).vertices();
        const double moved = i == 0 ? 1e30 : std::sqrt((Y - before).squaredNorm() / static_cast<double>(Y.rows()));
        if (settled && (moved < o.tolerance || idle >= o.idle)) {
            stop = Stop::converged;
            break;
        }
        before = Y;
        settled = reach <= o.reach;
        if (scan) {
            const Vertices normals = sample_normals(Y, model_.F, faces_of_, samples_);
            problem.matches = scan->match(Y, normals, samples_, reach, o.min_cosine, faces);
        }
        energies.push_back(descend(problem, state, damping, system).energy);
        if (settled) {
            idle = energies.back() < (1 - o.relative_decrease) * least ? 0 : idle + 1;
            least = std::min(least, energies.back());
        }
        reach = std::max(o.reach, 0.75 * reach);
    }
    SkeletonResult result = result_of(model_, problem, state, system);
    result.stop = scan && result.matched == 0 ? Stop::unmatched : stop;
    result.iterations = static_cast<int>(energies.size());
    result.energy = std::move(energies);
    check_solved("skeleton", "V", result.V);
    check_solved("skeleton", "energy", Eigen::Map<const Vector>(result.energy.data(), result.iterations));
    return result;
}

std::vector<SkeletonResult> SkeletonSolver::solve_shared(const std::vector<SkeletonFrame>& given, int rounds) const {
    require(!given.empty(), "skeleton: frames is empty");
    require(rounds > 0, "skeleton: rounds must be positive");
    const int S = model_.shapes();
    std::vector<SkeletonFrame> frames;
    for (const SkeletonFrame& frame : given) frames.push_back(trusted(frame, model_));
    const auto each_frame = [&](auto&& work) {
        parallel_for(static_cast<std::int64_t>(frames.size()),
                     [&](std::int64_t f) { work(static_cast<std::size_t>(f)); }, 1);
    };
    std::vector<std::unique_ptr<ScanSurface>> scans(frames.size());
    std::vector<SkeletonResult> results(frames.size());
    each_frame([&](std::size_t f) {  // each by itself; the mean shape starts the joint solve
        scans[f] = surface_of(frames[f]);
        results[f] = solve_on(scans[f].get(), frames[f]);
    });
    Vector shape = Vector::Zero(S);
    for (const SkeletonResult& r : results) shape += r.pose.shape / static_cast<double>(frames.size());
    if (S == 0) return results;
    SkeletonOptions fixed = options_;
    fixed.solve_shape = false;
    const SkeletonSolver poses(model_, joint_sigma_, joint_limit_, vertex_weights_, fixed);
    for (int round = 0; round <= rounds; ++round) {
        std::vector<MatrixXd> H_of(frames.size());
        std::vector<Vector> g_of(frames.size());
        each_frame([&](std::size_t f) {
            SkeletonFrame frame = frames[f];
            frame.start = {results[f].pose};
            frame.start[0].shape = shape;
            results[f] = poses.solve_on(scans[f].get(), frame);
            if (round == rounds) return;
            Problem problem(model_, joint_sigma_, joint_limit_, twist_, area_, frame, options_, true);
            problem.keypoint_robust = options_.keypoint_robust_sigmas;
            problem.surface_robust = options_.surface_robust;
            std::vector<int> faces;
            if (scans[f])
                problem.matches =
                    scans[f]->match(results[f].V, sample_normals(results[f].V, model_.F, faces_of_, samples_), samples_,
                                    options_.reach, options_.min_cosine, faces);
            const System s = problem.linearise(state_of(results[f].pose, model_));
            const int P = problem.shape_start();
            const MatrixXd C = s.H.bottomLeftCorner(S, P).transpose();
            const auto factor = damped_factor(s.H.topLeftCorner(P, P), 1e-9);
            H_of[f] =
                MatrixXd(s.H.bottomRightCorner(S, S).selfadjointView<Eigen::Lower>()) - C.transpose() * factor.solve(C);
            g_of[f] = s.g.tail(S) - C.transpose() * factor.solve(s.g.head(P));
        });
        if (round == rounds) break;
        MatrixXd H = MatrixXd::Zero(S, S);
        Vector g = Vector::Zero(S);
        for (std::size_t f = 0; f < frames.size(); ++f) H += H_of[f], g += g_of[f];
        const double excess =
            options_.shape_weight * static_cast<double>(frames.size() - 1);  // one prior, not one a frame
        H.diagonal().array() -= excess;
        g -= excess * shape;
        shape -= damped_factor(H, 1e-6).solve(g);
    }
    return results;
}

}  // namespace toile
