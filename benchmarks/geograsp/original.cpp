// SPDX-License-Identifier: Apache-2.0
// Times the published C++ GeoGrasp on clouds from the standard input (speed.py compiles and calls it).
// Input:  clouds until the end: int32 tip [mm], float32[4] plane, int32 n, float32[3 n] points [m].
// Output: for each cloud float64 processor time [ms] of one plan, float32[6] contacts of its best grasp [m].
// What GeoGrasp prints goes to the standard error.
#include <pcl/common/geometry.h>

#include <Eigen/Dense>

// PCL 1.7, for which GeoGrasp was written, takes vectors here; later versions take points alone.
namespace pcl::geometry {
inline float distance(const Eigen::Vector3f &p, const Eigen::Vector3f &q) { return (p - q).norm(); }
inline float distance(const Eigen::Map<Eigen::Vector3f> &p, const Eigen::Map<Eigen::Vector3f> &q) { return (p - q).norm(); }
}  // namespace pcl::geometry

#include <geograsp/GeoGrasp.cpp>

#include <cstdint>
#include <cstdio>
#include <ctime>
#include <unistd.h>
#include <vector>

static double processor_ms() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * now.tv_sec + 1e-6 * now.tv_nsec;
}

template <typename T>
static bool read(T *values, std::size_t count) {
  return std::fread(values, sizeof(T), count, stdin) == count;
}

int main() {
  std::FILE *out = fdopen(dup(STDOUT_FILENO), "wb");
  dup2(STDERR_FILENO, STDOUT_FILENO);
  std::int32_t tip, n;
  float plane[4];
  while (read(&tip, 1) && read(plane, 4) && read(&n, 1)) {
    std::vector<float> xyz(3 * n);
    if (!read(xyz.data(), xyz.size())) return 1;
    pcl::PointCloud<pcl::PointXYZ>::Ptr cloud(new pcl::PointCloud<pcl::PointXYZ>(n, 1));
    for (std::int32_t k = 0; k < n; ++k) {
      cloud->points[k] = pcl::PointXYZ(xyz[3 * k], xyz[3 * k + 1], xyz[3 * k + 2]);
    }
    pcl::ModelCoefficients table;
    table.values.assign(plane, plane + 4);

    const double began = processor_ms();
    GeoGrasp planner;
    planner.setBackgroundPlaneCoeff(table);
    planner.setObjectCloud(cloud);
    planner.setGripTipSize(tip);
    planner.setGrasps(1);
    planner.compute();
    const double took = processor_ms() - began;

    const GraspContacts best = planner.getBestGrasp();
    const float contacts[6] = {best.firstPoint.x,  best.firstPoint.y,  best.firstPoint.z,
                               best.secondPoint.x, best.secondPoint.y, best.secondPoint.z};
    std::fwrite(&took, sizeof took, 1, out);
    std::fwrite(contacts, sizeof(float), 6, out);
  }
  return std::fclose(out);
}
