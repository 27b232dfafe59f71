#include "kernels/biharmonic.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "base/errors.h"
#include "geometry/intrinsic.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"
#include "geometry/weld.h"

namespace toile {

namespace {

constexpr double MARGIN = 4;  // between the error of a factor on three fields and what is promised for any

void check_known(const Indices& known, Eigen::Index n) {
    require(known.size() > 0, "biharmonic: known is empty");
    check_indices("biharmonic", "known", known, n);
    std::vector<Eigen::Index> first(static_cast<std::size_t>(n), -1);
    for (Eigen::Index k = 0; k < known.size(); ++k) {
        auto& seen = first[static_cast<std::size_t>(known[k])];
        require(seen < 0, "biharmonic: known[" + std::to_string(k) + "] repeats vertex " + std::to_string(known[k]) +
                              " of known[" + std::to_string(seen) + "]");
        seen = k;
    }
}

/// Every component that has a face needs a known vertex: without one its displacement is not determined.
void check_components(const Faces& F, const Indices& known, Eigen::Index n) {
    const Indices component = vertex_components(F, n);
    std::vector<char> anchored(static_cast<std::size_t>(component.maxCoeff()) + 1, 0);
    for (const int v : known) anchored[static_cast<std::size_t>(component[v])] = 1;
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const int c = component[F(f, 0)];
        if (anchored[static_cast<std::size_t>(c)]) continue;
        throw InputError("biharmonic: known has no vertex in component " + std::to_string(c) + " (" +
                         std::to_string((component.array() == c).count()) + " vertices, face " + std::to_string(f) +
                         " at vertex " + std::to_string(F(f, 0)) + ")");
    }
}

Sparse columns(const Sparse& A, const std::vector<int>& chosen) {
    Sparse selection(A.cols(), static_cast<Eigen::Index>(chosen.size()));
    selection.reserve(Eigen::VectorXi::Ones(selection.cols()));
    for (std::size_t k = 0; k < chosen.size(); ++k) selection.insert(chosen[k], static_cast<Eigen::Index>(k)) = 1;
    return A * selection;
}

/// The largest absolute entry; infinity when one is not a number.
double largest(const Matrix& A) {
    return A.allFinite() ? A.cwiseAbs().maxCoeff() : std::numeric_limits<double>::infinity();
}

std::string scientific(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.1e", value);
    return text;
}

}  // namespace

BiharmonicSolver::BiharmonicSolver(const Vertices& V, const Faces& F_all, const Indices& known,
                                   const BiharmonicOptions& options)
    : options_(options), n_(V.rows()), known_(known.begin(), known.end()) {
    require(options.accuracy > 0 && options.accuracy <= 1,
            "biharmonic: accuracy is " + scientific(options.accuracy) + ", expected more than 0, at most 1");
    require(options.refinements >= 0, "biharmonic: refinements is negative");
    check_mesh("biharmonic", V, F_all);
    check_known(known, V.rows());
    const Faces F = distinct_faces(F_all, V.rows());  // one listed twice would pull twice
    require(F.rows() > 0, "biharmonic: F has no face of three different vertices");
    check_components(F, known, V.rows());

    std::vector<char> free(static_cast<std::size_t>(V.rows()), 0);
    for (Eigen::Index k = 0; k < F.size(); ++k) free[static_cast<std::size_t>(F.data()[k])] = 1;
    for (const int v : known_) free[static_cast<std::size_t>(v)] = 0;
    for (Eigen::Index v = 0; v < V.rows(); ++v)
        if (free[static_cast<std::size_t>(v)]) unknown_.push_back(static_cast<int>(v));
    if (unknown_.empty()) return;

    // A face of no area would only drop out of L and leave a slit; mollified it holds its corners together.
    if (face_areas(V, F).minCoeff() > 0 && factorize(cotangent_laplacian(V, F), voronoi_mass(V, F))) return;
    const Vertices lengths = edge_lengths(V, F);
    const double mean = lengths.mean();
    require(mean > 0 && std::isfinite(mean), "biharmonic: all faces of F have their corners in one point of V");
    for (const double margin : {1e-6, 1e-5, 1e-4, 1e-3, 1e-2}) {
        Vertices mollified = lengths;
        mollified_ = mollify(mollified, margin * mean);
        if (factorize(intrinsic_laplacian(mollified, F, V.rows()), intrinsic_voronoi_mass(mollified, F, V.rows())))
            return;
    }
    throw SolveError("biharmonic: the factor misses the constant field by " + scientific(factor_error_) +
                     " even with edges mollified by " + scientific(mollified_) + " m");
}

/// True when LL' exists and reproduces the constant field; sets whether solves are refined.
bool BiharmonicSolver::factorize(const Sparse& L, const Vector& mass) {
    L_ = L;
    inverse_mass_ = mass.cwiseInverse();
    factor_error_ = std::numeric_limits<double>::infinity();
    for (Eigen::Index v = 0; v < mass.size(); ++v)
        if (mass[v] == 0) inverse_mass_[v] = 0;
    for (const int v : unknown_)
        if (!(mass[v] > 0) || !std::isfinite(inverse_mass_[v])) return false;
    const Sparse L_u = columns(L, unknown_);
    const Sparse Q_uu = Sparse(L_u.transpose()) * inverse_mass_.asDiagonal() * L_u;  // (L M^-1 L)_uu
    coupling_ = -(Sparse(L_u.transpose()) * inverse_mass_.asDiagonal() * columns(L, known_));
    factor_.analyze(Q_uu);
    if (!factor_.try_factorize(Q_uu)) return false;
    Vertices D = Vertices::Zero(n_, 3);
    for (std::size_t k = 0; k < known_.size(); ++k)  // a constant, the roughest field, and one between
        D.row(known_[k]) << 1, k % 2 == 0 ? 1 : -1, std::sin(0.1 * static_cast<double>(k));
    substitute(D);
    const double error = std::max(error_of_one(D), largest(correction(D)));
    refine_ = options_.refinements > 0 && !(MARGIN * error <= options_.accuracy);
    if (refine_) settle(D);
    factor_error_ = error_of_one(D);
    return factor_error_ <= options_.accuracy;
}

/// How far the first column is from 1.
double BiharmonicSolver::error_of_one(const Vertices& D) const { return largest(D(unknown_, 0).array() - 1); }

/// D_u = -Q_uu^-1 Q_uk D_k with Q = L M^-1 L.
void BiharmonicSolver::substitute(Vertices& D) const {
    Matrix D_k(static_cast<Eigen::Index>(known_.size()), 3);
    for (std::size_t k = 0; k < known_.size(); ++k) D_k.row(static_cast<Eigen::Index>(k)) = D.row(known_[k]);
    const Matrix D_u = factor_.solve(coupling_ * D_k);
    for (std::size_t k = 0; k < unknown_.size(); ++k) D.row(unknown_[k]) = D_u.row(static_cast<Eigen::Index>(k));
}

/// What one step of refinement adds to the unknown rows: Q_uu^-1 r, r = -(L M^-1 L D)_u.
Matrix BiharmonicSolver::correction(const Vertices& D) const {
    const Matrix curvature = inverse_mass_.asDiagonal() * Matrix(L_ * D);
    const Matrix gradient = L_ * curvature;
    Matrix residual(static_cast<Eigen::Index>(unknown_.size()), 3);
    for (std::size_t k = 0; k < unknown_.size(); ++k)
        residual.row(static_cast<Eigen::Index>(k)) = -gradient.row(unknown_[k]);
    return factor_.solve(residual);
}

/// Refines the unknown rows of D while that shrinks; returns the last correction relative to the largest displacement.
double BiharmonicSolver::settle(Vertices& D) const {
    double last = std::numeric_limits<double>::infinity();
    for (int step = 0; step < options_.refinements; ++step) {
        const Matrix change = correction(D);
        const double size = largest(change);
        if (step > 0 && !(size < last)) break;  // at the floor of rounding
        for (std::size_t k = 0; k < unknown_.size(); ++k)
            D.row(unknown_[k]) += change.row(static_cast<Eigen::Index>(k));
        last = size;
        if (size <= 1e-15 * largest(D)) break;
    }
    const double extent = largest(D);
    return extent > 0 ? last / extent : 0;
}

Vertices BiharmonicSolver::solve(const Vertices& D_known) const {
    require(D_known.rows() == static_cast<Eigen::Index>(known_.size()),
            "biharmonic: D_known has " + std::to_string(D_known.rows()) + " rows, known has " +
                std::to_string(known_.size()));
    check_points("biharmonic", "D_known", D_known);
    const Eigen::RowVector3d offset = D_known.row(0);  // taken off first, so that translations are exact
    Vertices D = Vertices::Zero(n_, 3);
    for (std::size_t k = 0; k < known_.size(); ++k)
        D.row(known_[k]) = D_known.row(static_cast<Eigen::Index>(k)) - offset;
    if (!unknown_.empty()) {
        substitute(D);
        if (refine_)
            if (const double error = settle(D); !(error <= options_.accuracy))
                throw SolveError("biharmonic: refinement stalls at a relative correction of " + scientific(error));
        for (const int v : unknown_) D.row(v) += offset;
    }
    for (std::size_t k = 0; k < known_.size(); ++k) D.row(known_[k]) = D_known.row(static_cast<Eigen::Index>(k));
    return D;
}

Vertices biharmonic(const Vertices& V, const Faces& F, const Indices& known, const Vertices& D_known,
                    const BiharmonicOptions& options) {
    return BiharmonicSolver(V, F, known, options).solve(D_known);
}

}  // namespace toile
