// The part of Unity's API that the editor script uses, as documented (docs.unity3d.com, ScriptReference; HDRP's API), without
// any behaviour: a compiler shows that the script fits it. Unity itself does not run here.

using System;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;
        public static Vector3 operator -(Vector3 a, Vector3 b) { return a; }
    }

    public class Object
    {
        public string name { get; set; }
        public static bool operator ==(Object a, Object b) { return ReferenceEquals(a, b); }
        public static bool operator !=(Object a, Object b) { return !ReferenceEquals(a, b); }
        public override bool Equals(object other) { return ReferenceEquals(this, other); }
        public override int GetHashCode() { return 0; }
    }

    public class Component : Object { }
    public class Behaviour : Component { }
    public class MonoBehaviour : Behaviour { }
    public class Texture : Object { }
    public sealed class Cubemap : Texture { }

    public class Transform : Component
    {
        public Vector3 position { get; set; }
        public void SetParent(Transform parent, bool worldPositionStays) { }
    }

    public sealed class GameObject : Object
    {
        public GameObject(string name) { }
        public Transform transform { get { return null; } }
        public T AddComponent<T>() where T : Component { return null; }
        public static GameObject Find(string name) { return null; }
    }

    public sealed class ReflectionProbe : Behaviour
    {
        public Rendering.ReflectionProbeMode mode { get; set; }
        public Texture customBakedTexture { get; set; }
        public bool hdr { get; set; }
        public float intensity { get; set; }
        public int importance { get; set; }
        public Vector3 center { get; set; }
        public Vector3 size { get; set; }
        public float blendDistance { get; set; }
        public bool boxProjection { get; set; }
    }

    public static class JsonUtility
    {
        public static T FromJson<T>(string json) { return default(T); }
    }
}

namespace UnityEngine.Rendering
{
    public enum ReflectionProbeMode { Baked, Realtime, Custom }

    public abstract class RenderPipelineAsset : UnityEngine.Object { }

    public sealed class GraphicsSettings : UnityEngine.Object
    {
        public static RenderPipelineAsset currentRenderPipeline { get { return null; } }
    }
}

namespace UnityEngine.Rendering.HighDefinition
{
    public class HDRenderPipelineAsset : RenderPipelineAsset { }

    public enum InfluenceShape { Box, Sphere }

    public class InfluenceVolume
    {
        public InfluenceShape shape { get; set; }
        public Vector3 boxSize { get; set; }
        public Vector3 boxBlendDistancePositive { get; set; }
        public Vector3 boxBlendDistanceNegative { get; set; }
    }

    public class ProxyVolume
    {
        public Vector3 boxSize { get; set; }
    }

    public class ReflectionProxyVolumeComponent : MonoBehaviour
    {
        public ProxyVolume proxyVolume { get { return null; } }
    }

    public struct ProbeSettings
    {
        public enum Mode { Baked, Realtime, Custom }

        public struct ProxySettings
        {
            public Vector3 capturePositionProxySpace;
        }

        public ProxySettings proxySettings;
    }

    public abstract class HDProbe : MonoBehaviour
    {
        ProbeSettings settings;
        public ProbeSettings.Mode mode { get; set; }
        public float multiplier { get; set; }
        public InfluenceVolume influenceVolume { get { return null; } }
        public ReflectionProxyVolumeComponent proxyVolume { get; set; }
        public ref ProbeSettings settingsRaw { get { return ref settings; } }
        public Texture SetTexture(ProbeSettings.Mode targetMode, Texture texture) { return texture; }
    }

    public sealed class HDAdditionalReflectionData : HDProbe { }
}

namespace UnityEditor
{
    using UnityEngine;

    [AttributeUsage(AttributeTargets.Method)]
    public sealed class MenuItem : Attribute
    {
        public MenuItem(string itemName) { }
    }

    public static class EditorUtility
    {
        public static string OpenFilePanel(string title, string directory, string extension) { return null; }
    }

    public static class FileUtil
    {
        public static string GetProjectRelativePath(string path) { return path; }
    }

    public static class Undo
    {
        public static void DestroyObjectImmediate(UnityEngine.Object objectToUndo) { }
        public static void RegisterCreatedObjectUndo(UnityEngine.Object objectToUndo, string name) { }
    }

    public static class AssetDatabase
    {
        public static T LoadAssetAtPath<T>(string assetPath) where T : UnityEngine.Object { return null; }
    }
}
