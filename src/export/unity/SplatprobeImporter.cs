// Makes reflection probes of a splatprobe bake that was exported with --engine unity.
//
// Copy the exported folder into Assets. The cubemaps import by the .meta files beside them. Then choose
// Tools > Splatprobe > Create Reflection Probes and the folder's probes.json. Running it again replaces the probes that it
// made from the same folder before.

using System;
using System.IO;
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;
#if SPLATPROBE_HDRP
using UnityEngine.Rendering.HighDefinition;
#endif

namespace Splatprobe
{
    // The fields of probes.json. Positions and boxes are in Unity's world space, in metres.
    [Serializable]
    class Bake
    {
        public string generator;
        public float exposure;
        public float paperWhite;
        public string matchTonemapper;
        public float intensity;
        public Probe[] probes;
    }

    [Serializable]
    class Probe
    {
        public string id;
        public string cubemap;
        public Vector3 position;
        public int importance;
        public UniformBox box;
        public Influence influence;
        public Box proxy;
    }

    // The one box of URP and of the built-in pipeline.
    [Serializable]
    class UniformBox
    {
        public Vector3 centre;
        public Vector3 size;
        public float blendDistance;
        public bool isProjected;
    }

    [Serializable]
    class Influence
    {
        public Vector3 centre;
        public Vector3 size;
        public Vector3 blendPositive;
        public Vector3 blendNegative;
    }

    [Serializable]
    class Box
    {
        public Vector3 centre;
        public Vector3 size;
    }

    static class Importer
    {
        [MenuItem("Tools/Splatprobe/Create Reflection Probes...")]
        static void Choose()
        {
            string path = EditorUtility.OpenFilePanel("Choose the probes.json of an exported bake", "Assets", "json");
            if (!string.IsNullOrEmpty(path))
            {
                Create(FileUtil.GetProjectRelativePath(path.Replace('\\', '/')));
            }
        }

        // Makes the probes of a bake; path is that of its probes.json, from the project's folder ("Assets/...").
        public static GameObject Create(string path)
        {
            if (string.IsNullOrEmpty(path))
            {
                throw new ArgumentException("The exported folder must be inside of the project's Assets folder.");
            }
            string folder = Path.GetDirectoryName(path).Replace('\\', '/');
            Bake bake = JsonUtility.FromJson<Bake>(File.ReadAllText(path));
            if (bake.probes == null || bake.probes.Length == 0)
            {
                throw new InvalidDataException(path + " lists no probes; is it an export for Unity?");
            }

            string rootName = "Splatprobe " + Path.GetFileName(folder);
            GameObject earlier = GameObject.Find(rootName);
            if (earlier != null)
            {
                Undo.DestroyObjectImmediate(earlier);
            }
            GameObject root = new GameObject(rootName);
            Undo.RegisterCreatedObjectUndo(root, "Create Reflection Probes");
            foreach (Probe probe in bake.probes)
            {
                string asset = folder + "/" + probe.cubemap;
                Cubemap cubemap = AssetDatabase.LoadAssetAtPath<Cubemap>(asset);
                if (cubemap == null)
                {
                    throw new FileNotFoundException("No cubemap was imported from " + asset + "; is its .meta file there?");
                }
                Create(root.transform, bake, probe, cubemap);
            }
            return root;
        }

        static void Create(Transform root, Bake bake, Probe probe, Cubemap cubemap)
        {
            GameObject gameObject = new GameObject(probe.id);
            gameObject.transform.SetParent(root, false);
            // The transform is where the images were taken; the box may lie around another point.
            gameObject.transform.position = probe.position;
            ReflectionProbe component = gameObject.AddComponent<ReflectionProbe>();
            component.mode = ReflectionProbeMode.Custom;
            component.customBakedTexture = cubemap;
            component.hdr = true;
            component.intensity = bake.intensity;
            component.importance = probe.importance;
            component.center = probe.box.centre - probe.position;
            component.size = probe.box.size;
            component.blendDistance = probe.box.blendDistance;
            component.boxProjection = probe.box.isProjected;
#if SPLATPROBE_HDRP
            if (GraphicsSettings.currentRenderPipeline is HDRenderPipelineAsset)
            {
                AddHighDefinition(gameObject, bake, probe, cubemap);
            }
#endif
        }

#if SPLATPROBE_HDRP
        // HDRP has an influence box with a blend distance per face, around the transform, and a proxy box of its own.
        static void AddHighDefinition(GameObject gameObject, Bake bake, Probe probe, Cubemap cubemap)
        {
            gameObject.transform.position = probe.influence.centre;
            GameObject proxyObject = new GameObject(probe.id + " proxy");
            proxyObject.transform.SetParent(gameObject.transform, false);
            proxyObject.transform.position = probe.proxy.centre;
            ReflectionProxyVolumeComponent proxy = proxyObject.AddComponent<ReflectionProxyVolumeComponent>();
            proxy.proxyVolume.boxSize = probe.proxy.size;

            HDAdditionalReflectionData data = gameObject.AddComponent<HDAdditionalReflectionData>();
            data.mode = ProbeSettings.Mode.Custom;
            data.SetTexture(ProbeSettings.Mode.Custom, cubemap);
            data.multiplier = bake.intensity;
            data.influenceVolume.shape = InfluenceShape.Box;
            data.influenceVolume.boxSize = probe.influence.size;
            data.influenceVolume.boxBlendDistancePositive = probe.influence.blendPositive;
            data.influenceVolume.boxBlendDistanceNegative = probe.influence.blendNegative;
            data.proxyVolume = proxy;
            data.settingsRaw.proxySettings.capturePositionProxySpace = probe.position - probe.proxy.centre;
        }
#endif
    }
}
