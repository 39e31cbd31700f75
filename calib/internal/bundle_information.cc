#include "calib/internal/bundle_information.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "calib/error.h"

namespace plumbline {
namespace {

// Eigenvalues of information matrices scaled to a unit diagonal: below, rounding decides.
constexpr double kUndetermined = 1e-11;

}  // namespace

BundleResult::Information::Information(const BundleProblem& problem) {
  for (const BundleCamera& c : problem.cameras) {
    camera_start.push_back(c.fixed ? -1 : core_size);
    camera_size.push_back(c.camera.parameter_count());
    if (!c.fixed) core_size += camera_size.back();
  }
  for (const BundleMotion& m : problem.motions) {
    motion_start.push_back(m.fixed ? -1 : core_size);
    if (!m.fixed) core_size += 6;
  }
  std::vector<bool> in_distance(problem.points.size(), false);
  for (const KnownDistance& d : problem.distances) {
    in_distance[static_cast<std::size_t>(d.point_a)] = true;
    in_distance[static_cast<std::size_t>(d.point_b)] = true;
  }
  for (std::size_t p = 0; p < problem.points.size(); ++p) {
    point_free.push_back(!problem.points[p].fixed);
    point_start.push_back(point_free[p] && in_distance[p] ? core_size : -1);
    if (point_start[p] >= 0) core_size += 3;
  }
  eliminated.resize(problem.points.size());
  reduced = Eigen::MatrixXd::Zero(core_size, core_size);
}

std::string BundleResult::Information::NameOf(int core_entry) const {
  for (std::size_t k = 0; k < camera_start.size(); ++k) {
    const int i = core_entry - camera_start[k];
    if (camera_start[k] >= 0 && i >= 0 && i < camera_size[k]) {
      return "intrinsics of camera " + std::to_string(k);
    }
  }
  for (std::size_t k = 0; k < motion_start.size(); ++k) {
    const int i = core_entry - motion_start[k];
    if (motion_start[k] >= 0 && i >= 0 && i < 6) {
      return (i < 3 ? "rotation of motion " : "translation of motion ") + std::to_string(k);
    }
  }
  for (std::size_t k = 0; k < point_start.size(); ++k) {
    const int i = core_entry - point_start[k];
    if (point_start[k] >= 0 && i >= 0 && i < 3) return "point " + std::to_string(k);
  }
  return "core entry " + std::to_string(core_entry);
}

void BundleResult::Information::Add(const std::vector<Term>& terms, int eliminated_point) {
  const Term* point = nullptr;
  for (const Term& t : terms) {
    if (t.start < 0) point = &t;
  }
  if (point != nullptr) {
    Eliminated& e = eliminated[static_cast<std::size_t>(eliminated_point)];
    e.information += point->J.transpose() * point->J;
  }
  for (const Term& a : terms) {
    if (a.start < 0) continue;
    for (const Term& b : terms) {
      if (b.start < 0) continue;
      reduced.block(a.start, b.start, a.J.cols(), b.J.cols()) += a.J.transpose() * b.J;
    }
    if (point == nullptr) continue;
    Eliminated& e = eliminated[static_cast<std::size_t>(eliminated_point)];
    auto at = std::find(e.core.begin(), e.core.end(), a.start);
    auto first = static_cast<Eigen::Index>(at - e.core.begin());
    if (at == e.core.end()) {
      for (int i = 0; i < static_cast<int>(a.J.cols()); ++i) e.core.push_back(a.start + i);
      e.coupling.conservativeResize(3, static_cast<Eigen::Index>(e.core.size()));
      e.coupling.rightCols(a.J.cols()).setZero();
    }
    e.coupling.middleCols(first, a.J.cols()) += point->J.transpose() * a.J;
  }
}

void BundleResult::Information::Reduce() {
  for (std::size_t p = 0; p < eliminated.size(); ++p) {
    if (!IsEliminated(static_cast<int>(p))) continue;
    const Eliminated& e = eliminated[p];
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(e.information);
    if (!(eigen.eigenvalues()[0] > kUndetermined * eigen.eigenvalues()[2])) {
      throw InputError(
          "bundle adjustment: point " + std::to_string(p) +
          " is not determined by its observations; it needs two rays that cross, or to "
          "be held fixed");
    }
    const Eigen::MatrixXd update =
        e.coupling.transpose() * e.information.llt().solve(Eigen::MatrixXd(e.coupling));
    for (std::size_t i = 0; i < e.core.size(); ++i) {
      for (std::size_t j = 0; j < e.core.size(); ++j) {
        reduced(e.core[i], e.core[j]) -=
            update(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
      }
    }
  }
  reduced = (0.5 * (reduced + reduced.transpose())).eval();
}

BundleResult::Information::NullSpace BundleResult::Information::Undetermined() const {
  NullSpace out;
  // A direction that nothing sees cancels in the Schur complement, its diagonal too: scale by what
  // is left, but never by nothing.
  out.scale = reduced.diagonal().cwiseAbs().cwiseMax(1e-30).cwiseSqrt();
  const Eigen::VectorXd inverse = out.scale.cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(inverse.asDiagonal() * reduced *
                                                             inverse.asDiagonal());
  const Eigen::Index nullity = (eigen.eigenvalues().array() < kUndetermined).count();
  out.scaled = eigen.eigenvectors().leftCols(nullity);
  return out;
}

void BundleResult::Information::Invert() {
  const Eigen::VectorXd inverse = reduced.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = inverse.asDiagonal() * reduced * inverse.asDiagonal();
  core_covariance = inverse.asDiagonal() *
                    scaled.ldlt().solve(Eigen::MatrixXd::Identity(core_size, core_size)) *
                    inverse.asDiagonal();
}

Eigen::MatrixXd BundleResult::Information::Joint(const std::vector<BundleBlock>& blocks) const {
  // Each block as own noise plus a linear map of the core.
  std::vector<Eigen::MatrixXd> maps;
  Eigen::Index total = 0;
  for (const BundleBlock& b : blocks) {
    const auto k = static_cast<std::size_t>(b.index);
    int start = -1, size = 3;
    if (b.kind == BundleBlock::Kind::kCamera) {
      start = camera_start.at(k);
      size = camera_size.at(k);
    } else if (b.kind == BundleBlock::Kind::kMotion) {
      start = motion_start.at(k);
      size = 6;
    } else {
      start = point_start.at(k);
    }
    Eigen::MatrixXd map = Eigen::MatrixXd::Zero(size, core_size);
    if (start >= 0) map.middleCols(start, size).setIdentity();
    if (b.kind == BundleBlock::Kind::kPoint && IsEliminated(b.index)) {
      const Eliminated& e = eliminated[k];
      const Eigen::MatrixXd T = -e.information.llt().solve(Eigen::MatrixXd(e.coupling));
      for (std::size_t i = 0; i < e.core.size(); ++i) {
        map.col(e.core[i]) = T.col(static_cast<Eigen::Index>(i));
      }
    }
    maps.push_back(map);
    total += size;
  }
  Eigen::MatrixXd out(total, total);
  Eigen::Index row = 0;
  for (std::size_t a = 0; a < maps.size(); ++a) {
    Eigen::Index column = 0;
    const Eigen::MatrixXd left = maps[a] * core_covariance;
    for (std::size_t b = 0; b < maps.size(); ++b) {
      out.block(row, column, maps[a].rows(), maps[b].rows()) = left * maps[b].transpose();
      const bool same_point = blocks[a].kind == BundleBlock::Kind::kPoint &&
                              blocks[b].kind == BundleBlock::Kind::kPoint &&
                              blocks[a].index == blocks[b].index;
      if (same_point && IsEliminated(blocks[a].index)) {
        const auto k = static_cast<std::size_t>(blocks[a].index);
        out.block(row, column, 3, 3) += eliminated[k].information.inverse();
      }
      column += maps[b].rows();
    }
    row += maps[a].rows();
  }
  return out;
}

}  // namespace plumbline
