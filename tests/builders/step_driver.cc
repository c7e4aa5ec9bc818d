// Steps a scene without Python, on processors that are emulated: step_driver PLUGIN_LIBRARY SCENE.xml STEPS prints
// qpos.

#include <mujoco/mujoco.h>

#include <cstdio>
#include <cstdlib>

int main(int argc, char** argv) {
  if (argc != 4) return std::fprintf(stderr, "step_driver PLUGIN_LIBRARY SCENE.xml STEPS\n"), 2;
  char error[1000] = "";
  mj_loadPluginLibrary(argv[1]);
  mjModel* model = mj_loadXML(argv[2], nullptr, error, sizeof(error));
  if (!model) return std::fprintf(stderr, "%s\n", error), 1;
  mjData* data = mj_makeData(model);
  for (int step = std::atoi(argv[3]); step > 0; step--) mj_step(model, data);
  for (int i = 0; i < model->nq; i++) std::printf("%.17g ", data->qpos[i]);
  mj_deleteData(data);
  mj_deleteModel(model);
  return 0;
}
