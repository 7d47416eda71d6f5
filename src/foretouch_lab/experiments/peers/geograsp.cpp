// SPDX-License-Identifier: Apache-2.0
// Plan a grasp with the published C++ GeoGrasp, whose source a checkout holds. A library that peers/__init__.py compiles and calls.
#include <pcl/common/geometry.h>

#include <Eigen/Dense>

// PCL 1.7, for which GeoGrasp was written, takes vectors here; later versions take points alone.
namespace pcl::geometry {
inline float distance(const Eigen::Vector3f &p, const Eigen::Vector3f &q) { return (p - q).norm(); }
inline float distance(const Eigen::Map<Eigen::Vector3f> &p, const Eigen::Map<Eigen::Vector3f> &q) { return (p - q).norm(); }
}  // namespace pcl::geometry

#include <geograsp/GeoGrasp.cpp>

#include <cstdint>
#include <exception>
#include <iostream>
#include <omp.h>

// Runs all parallel regions on one thread, also those of PCL, which ask for all processors.
struct OneThread {
  const int levels = omp_get_max_active_levels();
  OneThread() { omp_set_max_active_levels(0); }
  ~OneThread() { omp_set_max_active_levels(levels); }
};

// Plan the best grasp of n points. Returns 0, or 1 after an error of PCL.
//
// xyz: (n, 3) points [m]; plane: coefficients of the table; tip_mm: size of a fingertip [mm]; found: (3, 3) gets both
// contacts [m] and the axis of the object.
extern "C" int geograsp(std::int32_t n, const float *xyz, const float *plane, std::int32_t tip_mm, float *found) try {
  const OneThread one_thread;
  std::cout.setstate(std::ios_base::failbit);  // it prints what it does
  pcl::PointCloud<pcl::PointXYZ>::Ptr cloud(new pcl::PointCloud<pcl::PointXYZ>(n, 1));
  for (std::int32_t k = 0; k < n; ++k) {
    cloud->points[k] = pcl::PointXYZ(xyz[3 * k], xyz[3 * k + 1], xyz[3 * k + 2]);
  }
  pcl::ModelCoefficients table;
  table.values.assign(plane, plane + 4);

  GeoGrasp planner;
  planner.setBackgroundPlaneCoeff(table);
  planner.setObjectCloud(cloud);
  planner.setGripTipSize(tip_mm);
  planner.setGrasps(1);
  planner.compute();

  const GraspContacts best = planner.getBestGrasp();
  const std::vector<float> axis = planner.getObjectAxisCoeff().values;  // point and direction of a line
  const float all[9] = {best.firstPoint.x,  best.firstPoint.y,  best.firstPoint.z, best.secondPoint.x, best.secondPoint.y,
                        best.secondPoint.z, axis.at(3),         axis.at(4),        axis.at(5)};
  std::copy(all, all + 9, found);
  return 0;
} catch (const std::exception &) {
  return 1;
}
